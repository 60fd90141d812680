"""pycolmap's options and configurations of a bundle adjustment, one change each."""

import numpy as np
import pycolmap
import pycolmap.pyceres
from pycolmap import BundleAdjustmentGauge as Gauge

from tests.rig_scenes import rig_problem
from tests.scenes import make_problem, with_observations

LOSSES = ("TRIVIAL", "SOFT_L1", "CAUCHY", "HUBER")


def images_alone(seed=0, **changes):
    """Eight images of two cameras; every point is in three to eight of them."""
    problem = make_problem(num_images=8, num_points=60, seed=seed, **changes)
    problem = problem.replace(image_camera=np.arange(8) % 2).select(cameras=[0, 1]).problem
    return varied_tracks(problem, seed).to_pycolmap()


def rigs(seed=0, **changes):
    """Two rigs with two and three sensors, and two images without a rig."""
    arms = (
        ((0.01, 0.02, -0.01, -0.5, 0.02, 0.01),),
        tuple((0.02 * k, -0.1 * k, 0.01, 0.2 * k, 0.1, -0.05 * k) for k in (-1, 1)),
    )
    problem = rig_problem(rigs=arms, num_alone=2, num_points=60, seed=seed, **changes)
    return varied_tracks(problem, seed).to_pycolmap()


def varied_tracks(problem, seed):
    """Leave out a share of the observations, but at most so many that each point keeps three."""
    rng = np.random.default_rng([seed, 7])
    length = rng.integers(3, problem.num_images + 1, problem.num_points)
    order = np.lexsort((rng.random(problem.num_observations), problem.observation_point))
    rank = np.empty(problem.num_observations, int)
    rank[order] = np.arange(problem.num_observations)
    first = np.searchsorted(problem.observation_point[order], np.arange(problem.num_points))
    keep = rank - first[problem.observation_point] < length[problem.observation_point]
    return with_observations(problem, keep)


def option(name, value):
    def change(options, _config, _reconstruction, _rng):
        setattr(options, name, value)

    return change


def ceres(name, value):
    def change(options, _config, _reconstruction, _rng):
        setattr(options.ceres, name, value)

    return change


def solver(name, value):
    def change(options, _config, _reconstruction, _rng):
        setattr(options.ceres.solver_options, name, value)

    return change


def loss(name, scale):
    def change(options, _config, _reconstruction, _rng):
        options.ceres.loss_function_type = pycolmap.LossFunctionType.__members__[name]
        options.ceres.loss_function_scale = scale

    return change


def linear_solver(name):
    def change(options, _config, _reconstruction, _rng):
        options.ceres.auto_select_solver_type = False
        options.ceres.solver_options.linear_solver_type = (
            pycolmap.pyceres.LinearSolverType.__members__[name]
        )

    return change


def dogleg(options, _config, _reconstruction, _rng):
    solver_options = options.ceres.solver_options
    solver_options.trust_region_strategy_type = pycolmap.pyceres.TrustRegionStrategyType.DOGLEG


def gauge(value):
    def change(_options, config, _reconstruction, _rng):
        config.fix_gauge(value)

    return change


def drawn(ids, rng, count):
    return sorted(rng.permutation(sorted(ids))[:count].tolist())


def constant_frames(count):
    def change(_options, config, reconstruction, rng):
        for frame_id in drawn(reconstruction.frames, rng, count):
            config.set_constant_rig_from_world_pose(frame_id)

    return change


def constant_cameras(_options, config, reconstruction, rng):
    for camera_id in drawn(reconstruction.cameras, rng, 1):
        config.set_constant_cam_intrinsics(camera_id)


def constant_sensors(_options, config, reconstruction, rng):
    sensors = [s for rig in reconstruction.rigs.values() for s in rig.non_ref_sensors]
    for k in rng.permutation(len(sensors))[:1]:
        config.set_constant_sensor_from_rig_pose(sensors[k])


def constant_points(_options, config, reconstruction, rng):
    for point_id in drawn(reconstruction.points3D, rng, 10):
        config.remove_variable_point(point_id)
        config.add_constant_point(point_id)


def variable_points(_options, config, reconstruction, rng):
    for point_id in drawn(reconstruction.points3D, rng, 10):
        if not config.has_constant_point(point_id):
            config.add_variable_point(point_id)


def fewer_images(count):
    def change(_options, config, _reconstruction, rng):
        for image_id in drawn(config.images, rng, count):
            config.remove_image(image_id)

    return change


CHANGES = {
    "defaults": lambda *_: None,
    **{
        f"{name}={value}": option(name, value)
        for name in (
            *("refine_focal_length", "refine_principal_point", "refine_extra_params"),
            *("refine_rig_from_world", "refine_sensor_from_rig", "refine_points3D"),
            "constant_rig_from_world_rotation",
        )
        for value in (False, True)
    },
    **{f"min_track_length={n}": option("min_track_length", n) for n in (2, 4, 6, 9)},
    **{f"{name} {scale}": loss(name, scale) for name in LOSSES for scale in (0.5, 2.0)},
    **{f"frames {n}": constant_frames(n) for n in (1, 2, 3)},
    "cameras": constant_cameras,
    "sensors": constant_sensors,
    "constant points": constant_points,
    "variable points": variable_points,
    **{f"without {n} images": fewer_images(n) for n in (1, 3, 5)},
    **{f"gauge {value.name}": gauge(value) for value in Gauge.__members__.values()},
    "radius": solver("initial_trust_region_radius", 1e6),
    "dogleg": dogleg,
    "iterations": solver("max_num_iterations", 3),
    "function tolerance": solver("function_tolerance", 1e-3),
    "threads": solver("num_threads", 2),
    "DENSE_SCHUR": linear_solver("DENSE_SCHUR"),
    "SPARSE_SCHUR": linear_solver("SPARSE_SCHUR"),
    "use_gpu": ceres("use_gpu", True),
    "line search options": solver("max_lbfgs_rank", 7),
}
"""Changes by name; each is called with options, configuration, reconstruction and generator."""
EARLY = {"iterations", "function tolerance"}
"""Changes that stop the solve before its minimum."""


def request(reconstruction, names, seed=0):
    """Return options and configuration with the named changes, for tight tolerances."""
    rng = np.random.default_rng([seed, 3])
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    solver_options = options.ceres.solver_options
    solver_options.gradient_tolerance = 1e-9
    solver_options.function_tolerance = 1e-15
    solver_options.max_num_iterations = 400
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in reconstruction.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(Gauge.TWO_CAMS_FROM_WORLD)
    for name in names:
        CHANGES[name](options, config, reconstruction, rng)
    return options, config
