"""Random small problems with everything that a covariance has to count, beside their dense form."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from tests.analysis.uncertainty.dense import Dense
from tests.rig_scenes import STEREO, rig_problem
from tests.scenes import make_problem

LOSSES = ("trivial", "huber", "soft_l1", "cauchy", "arctan", "tukey")
MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")


@dataclass
class Case:
    problem: bundle.Problem
    settings: dict
    factors: list
    dense: Dense
    basis: np.ndarray  # columns of the dense form x unknowns
    num_prior_rows: int
    joins_points: bool = False  # a factor joins a free point with another free variable


def random_case(seed, *, joins_points=None):
    """A problem off its minimum: an information is that of the place.

    ``joins_points``: False: no factor joins points; None: in half of the seeds.
    """
    rng = np.random.default_rng(seed)
    model = rng.choice(MODELS)
    is_rig = rng.random() < 0.4
    if is_rig:
        problem = rig_problem(
            num_frames=int(rng.integers(3, 5)),
            num_alone=int(rng.integers(0, 2)),
            num_points=int(rng.integers(14, 20)),
            model=model,
            seed=seed,
            rigs=(STEREO,),
        )
    else:
        problem = make_problem(
            num_images=int(rng.integers(3, 6)),
            num_points=int(rng.integers(14, 20)),
            model=model,
            seed=seed,
            shared=rng.random() < 0.5,
            track=None if rng.random() < 0.5 else 3,
        )
    if rng.random() < 0.3:
        sigmas = rng.uniform(0.5, 3, problem.num_observations)
        problem = problem.replace(observation_sigma=sigmas)
    shares_focal = problem.num_cameras > 1 and rng.random() < 0.4
    if shares_focal:  # as the rule would make them
        params = problem.camera_params.copy()
        params[:, 0] = params[:, 0].mean()
        problem = problem.replace(camera_params=params)
    loss = str(rng.choice(LOSSES))
    loss_scale = float(rng.uniform(8, 20)) if loss == "tukey" else float(rng.uniform(1, 4))
    settings = {"loss": loss, **({} if loss == "trivial" else {"loss_scale": loss_scale})}
    dense = Dense(problem, loss=loss, loss_scale=loss_scale)
    free = dict.fromkeys(dense.names, True)

    # What is refined and held.
    sensors = is_rig and rng.random() < 0.5
    settings["refine_sensor_from_rig"] = bool(sensors)
    kinds = _parameter_kinds(model)
    width = problem.camera_params.shape[1]
    refine = ["poses", "points", "focal", "extra"]
    if rng.random() < 0.3:
        refine.append("principal_point")
    if rng.random() < 0.2:
        refine.remove("extra")
    settings["refine"] = tuple(refine)
    for camera in range(problem.num_cameras):
        for j in range(width):
            free["camera", camera, j] = kinds[j] in refine
    for name in dense.names:
        if name[0] == "sensor":
            free[name] = sensors
    if rng.random() < 0.3:
        points = rng.choice(problem.num_points, 2, replace=False)
        settings["fixed_point_ids"] = tuple(int(problem.point_ids[p]) for p in points)
        free |= {("point", int(p), k): False for p in points for k in range(3)}
    if not is_rig and rng.random() < 0.3:
        image = int(rng.integers(problem.num_images))
        settings["fixed_image_ids"] = (int(problem.image_ids[image]),)
        free |= {("image", image, k): False for k in range(6)}

    factors = []
    before = len(dense.residual)
    if rng.random() < 0.4:
        _known_focal(problem, dense, factors, rng)
    if rng.random() < 0.3:
        _known_point(problem, dense, factors, rng)
    if not is_rig and rng.random() < 0.3:
        for image in rng.choice(problem.num_images, int(rng.integers(1, 4)), replace=False):
            _known_position(problem, dense, factors, int(image), rng)
    own = np.random.default_rng([seed, 1])  # all else is as without
    if own.random() < 0.5 and joins_points is not False:
        known_distances(problem, dense, factors, own, has_image=not is_rig and own.random() < 0.5)

    basis = np.eye(len(dense.names))[:, [free[name] for name in dense.names]]
    if shares_focal:
        basis = _share_focal(problem, dense, free, settings)
    rows = dense.jacobian[before:] != 0
    of_points = np.array([name[0] == "point" for name in dense.names])
    used = basis.any(axis=1)
    joins = (rows[:, used & of_points].sum(axis=1) > 3) | (
        rows[:, used & of_points].any(axis=1) & rows[:, used & ~of_points].any(axis=1)
    )
    return Case(
        problem, settings, factors, dense, basis, len(dense.residual) - before, bool(joins.any())
    )


def _parameter_kinds(model):
    return {
        "SIMPLE_PINHOLE": ("focal", "principal_point", "principal_point"),
        "PINHOLE": ("focal", "focal", "principal_point", "principal_point"),
        "SIMPLE_RADIAL": ("focal", "principal_point", "principal_point", "extra"),
        "RADIAL": ("focal", "principal_point", "principal_point", "extra", "extra"),
        "OPENCV": ("focal", "focal", "principal_point", "principal_point", *("extra",) * 4),
    }[model]


def _known_focal(problem, dense, factors, rng):
    camera = int(rng.integers(problem.num_cameras))
    width = problem.camera_params.shape[1]
    sigma = float(rng.uniform(5, 50))
    sigmas = np.full(width, 1e3)
    sigmas[0] = sigma
    value = problem.camera_params[camera] + rng.normal(0, 1, width)
    information = np.diag(1 / sigmas**2)
    factors.append(
        bundle.PriorFactor(("camera", int(problem.camera_ids[camera])), value, information)
    )
    residual = (problem.camera_params[camera] - value) / sigmas
    rows = np.diag(1 / sigmas)
    dense.add(residual, {("camera", camera, j): rows[j] for j in range(width)})


def _known_point(problem, dense, factors, rng):
    point = int(rng.integers(problem.num_points))
    sigma = float(rng.uniform(0.01, 0.5))
    value = problem.points[point] + rng.normal(0, sigma, 3)
    key = ("point", int(problem.point_ids[point]))
    factors.append(bundle.PriorFactor(key, value, np.eye(3) / sigma**2))
    residual = (problem.points[point] - value) / sigma
    dense.add(residual, {("point", point, k): np.eye(3)[k] / sigma for k in range(3)})


def _known_position(problem, dense, factors, image, rng):
    sigma = float(rng.uniform(0.01, 0.3))
    centre, by_pose = _centre(problem, image)
    value = centre + rng.normal(0, sigma, 3)
    key = ("image", int(problem.image_ids[image]))
    factors.append(bundle.PositionFactor(key, value, np.eye(3) / sigma**2))
    rows = {("image", image, k): by_pose[:, k] / sigma for k in range(6)}
    dense.add((centre - value) / sigma, rows)


def _centre(problem, image):
    """Centre and its derivatives by (w, t): dc = -R^T (t x w) - R^T dt."""
    rotation = Rotation.from_quat(problem.cam_from_world[image, :4]).as_matrix()
    translation = problem.cam_from_world[image, 4:]
    by_turn = np.stack([-rotation.T @ np.cross(translation, e) for e in np.eye(3)], axis=1)
    return -rotation.T @ translation, np.hstack([by_turn, -rotation.T])


def known_distances(problem, dense, factors, rng, *, has_image):
    """Distances along a chain of points, and from a camera to the first of them: one factor."""
    points = rng.choice(problem.num_points, int(rng.integers(2 - has_image, 5)), replace=False)
    image, sigma = int(rng.integers(problem.num_images)), float(rng.uniform(0.01, 0.3))
    keys = [("image", int(problem.image_ids[image]))] * has_image
    keys += [("point", int(problem.point_ids[p])) for p in points]
    places, by_pose = list(problem.points[points]), np.zeros((3, 6))
    if has_image:
        centre, by_pose = _centre(problem, image)
        places.insert(0, centre)
    lengths = np.linalg.norm(np.diff(places, axis=0), axis=1)
    lengths += rng.normal(0, sigma, len(lengths))

    def along(x):  # distances and their derivatives by each place (m, 3)
        lines = np.diff(x, axis=0)
        norms = np.linalg.norm(lines, axis=1)
        by = np.zeros((len(x), len(lines), 3))
        for k, line in enumerate(lines):
            by[k, k], by[k + 1, k] = -line / norms[k], line / norms[k]
        return (norms - lengths) / sigma, by / sigma

    def function(values):
        if not has_image:
            return along(np.array(values))
        pose, *rest = values
        turn = Rotation.from_quat(pose[:4]).as_matrix()
        c = -turn.T @ pose[4:]
        residual, by = along(np.array([c, *rest]))
        by_own = np.hstack([np.cross(c, np.eye(3)).T, -np.eye(3)])  # c + c x phi - rho
        return residual, [by[0] @ by_own, *by[1:]]

    factors.append(bundle.FunctionFactor(keys, function))
    residual, by = along(np.array(places))
    rows = {}
    if has_image:
        rows = {("image", image, k): by[0] @ by_pose[:, k] for k in range(6)}
    for p, of in zip(points, by[int(has_image) :], strict=True):
        rows |= {("point", int(p), k): of[:, k] for k in range(3)}
    dense.add(residual, rows)


def _share_focal(problem, dense, free, settings):
    """All focal lengths (the first parameter) become multiples of one number."""
    settings["constraints"] = [
        "cameras *: share " + bundle.camera_models()[problem.camera_models[0]][0]
    ]
    columns = [j for j, name in enumerate(dense.names) if free[name] and name[::2] != ("camera", 0)]
    basis = np.eye(len(dense.names))[:, columns]
    tied = np.zeros((len(dense.names), 1))
    for camera in range(problem.num_cameras):
        tied[dense.column["camera", camera, 0]] = 1
    return np.hstack([basis, tied])
