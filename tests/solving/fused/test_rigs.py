"""Rigs of several sensors: the steps of both backends, and what the solves must leave alone."""

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests.rig_scenes import STEREO, rig_problem
from tests.solving.fused.measured_steps import first_measured

THREE = (*STEREO, (-0.02, 0.3, 0.01, 0.3, 0.1, -0.2))
SCENES = {
    "stereo": {},
    "three": {"rigs": (THREE,), "model": "SIMPLE_RADIAL"},
    "two rigs and more": {"rigs": (STEREO, THREE), "num_frames": 2, "num_alone": 2},
    "images missing": {"rigs": (THREE,), "missing": ((0, 1, 0), (0, 2, 1), (0, 2, 2))},
}
ROWS = {
    "fixed": ("stereo", "dense_schur", {}),
    "fixed, sparse": ("three", "sparse_schur", {"gauge": "two_cameras"}),
    "fixed, iterative": ("two rigs and more", "iterative_schur", {}),
    "refined": ("three", "dense_schur", {"refine_sensor_from_rig": True, "gauge": "two_cameras"}),
    "refined, sparse": ("two rigs and more", "sparse_schur", {"refine_sensor_from_rig": True}),
    "refined, iterative": ("stereo", "iterative_schur", {"refine_sensor_from_rig": True}),
    "robust": ("images missing", "dense_schur", {"loss": "huber", "loss_scale": 1.0}),
    "robust, refined": (
        "images missing",
        "sparse_schur",
        {"refine_sensor_from_rig": True, "loss": "cauchy", "loss_scale": 2.0},
    ),
    "held": (
        "two rigs and more",
        "dense_schur",
        {"refine_sensor_from_rig": True, "fixed_image_ids": (1,), "fixed_sensors": ((2, 4),)},
    ),
    # The other cameras are refined, those of the images alone in the own part of their image.
    "one camera held": ("two rigs and more", "dense_schur", {"fixed_camera_ids": (4,)}),
    "cameras held, refined": (
        "two rigs and more",
        "sparse_schur",
        {"refine_sensor_from_rig": True, "fixed_camera_ids": (2, 3)},
    ),
    "only sensors": (
        "three",
        "dense_schur",
        {"refine_sensor_from_rig": True, "refine": "points,focal"},
    ),
    "dogleg": (
        "stereo",
        "dense_schur",
        {
            "refine_sensor_from_rig": True,
            "gauge": "two_cameras",
            "trust_region_strategy_type": "subspace_dogleg",
        },
    ),
}


@functools.cache
def solves(name):
    scene, solver, options = ROWS[name]
    problem = rig_problem(perturbation=4e-2, **SCENES[scene])
    options = {
        "gauge": "none",
        "linear_solver_type": solver,
        "preconditioner_type": "schur_jacobi" if solver == "iterative_schur" else "auto",
        "max_num_iterations": 6,
        "function_tolerance": 1e-12,
        "num_threads": 2,
        **options,
    }
    return [bundle.solve(problem, backend=backend, **options) for backend in ("ceres", "fused")]


@pytest.mark.parametrize("name", ROWS)
def test_same_steps_as_ceres(name):
    expected, found = solves(name)
    assert found.summary.initial_cost == pytest.approx(expected.summary.initial_cost, rel=1e-12)
    assert len(found.iterations["cost"]) > 4
    first = first_measured(expected.iterations)
    for column, tolerance in (("cost", 1e-9), ("trust_region_radius", 1e-5)):
        np.testing.assert_allclose(
            found.iterations[column], expected.iterations[column], rtol=tolerance
        )
    np.testing.assert_allclose(
        found.iterations["step_norm"][first:], expected.iterations["step_norm"][first:], rtol=1e-4
    )
    for count in ("num_parameters", "num_parameter_blocks", "num_residuals"):
        assert getattr(found.summary, count) == getattr(expected.summary, count)
    nonzeros = "num_information_nonzeros"
    assert getattr(found.summary, nonzeros) == getattr(expected.summary, nonzeros)
    for array in ("rig_from_world", "sensor_from_rig", "cam_from_world", "camera_params"):
        np.testing.assert_allclose(
            getattr(found.problem, array), getattr(expected.problem, array), rtol=1e-6, atol=1e-6
        )


@pytest.mark.parametrize("name", ROWS)
def test_results_compose(name):
    """A Problem is refused unless cam_from_world = sensor_from_rig * rig_from_world."""
    for result in solves(name):
        bundle.Problem.replace(result.problem)


def test_what_is_held_keeps_its_bits():
    for result in solves("held"):
        before, after = result.initial_problem, result.problem
        frame = before.image_frame[0]
        assert before.image_ids[0] == 1
        moved = (before.rig_from_world != after.rig_from_world).any(axis=1)
        assert np.flatnonzero(~moved).tolist() == [frame]
        held = (before.sensor_rig_ids == 2) & (before.sensor_camera_ids == 4)
        assert held.sum() == 1
        moved = (before.sensor_from_rig != after.sensor_from_rig).any(axis=1)
        assert moved.tolist() == (~held).tolist()
        reference = (before.image_frame == frame) & (before.image_sensor < 0)
        np.testing.assert_array_equal(
            before.cam_from_world[reference], after.cam_from_world[reference]
        )


def test_sensors_stay_unless_they_are_refined():
    for result in solves("fixed"):
        np.testing.assert_array_equal(
            result.problem.sensor_from_rig, result.initial_problem.sensor_from_rig
        )


@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur", "iterative_schur"])
@pytest.mark.parametrize("refined", [False, True])
def test_same_bits_for_any_number_of_threads(solver, refined):
    problem = rig_problem(rigs=(THREE,), num_frames=12, num_points=150)
    results = [
        bundle.solve(
            problem,
            backend="fused",
            linear_solver_type=solver,
            refine_sensor_from_rig=refined,
            deterministic=True,
            num_threads=threads,
            max_num_iterations=4,
            gauge="two_cameras",
        )
        for threads in (1, 4)
    ]
    for array in ("rig_from_world", "sensor_from_rig", "cam_from_world", "points"):
        one, four = (getattr(result.problem, array) for result in results)
        np.testing.assert_array_equal(one, four)


def factors_of(problem):
    rng = np.random.default_rng(3)
    for image in (0, 1, 4):
        yield bundle.PositionFactor(
            ("image", int(problem.image_ids[image])),
            problem.projection_centers[image] + 0.02 * rng.standard_normal(3),
            1e4 * np.eye(3),
            lever_arm=(0.05, -0.02, 0.1),
        )
    measured = [0, 0, 0, 1.0, -0.4, 0, 0]
    keys = [("image", int(problem.image_ids[image])) for image in (0, 1)]  # of one frame
    yield bundle.RelativePoseFactor(*keys, measured, 1e5 * np.eye(6))

    frame = ("frame", int(problem.frame_ids[2]))
    yield bundle.PriorFactor(frame, problem.rig_from_world[2] + 0.01, 1e4 * np.eye(6))
    sensor = ("sensor", (1, 2))
    yield bundle.PriorFactor(sensor, problem.sensor_from_rig[0] + 0.02, 1e4 * np.eye(6))


@pytest.mark.parametrize("refined", [False, True])
def test_factors_move_frames_and_sensors(refined):
    problem = rig_problem()
    expected, found = (
        bundle.solve(
            problem,
            factors=list(factors_of(problem)),
            backend=backend,
            refine_sensor_from_rig=refined,
            max_num_iterations=8,
            gauge="none",
        )
        for backend in ("ceres", "fused")
    )
    assert found.factor_costs_before.sum() > 0.01 * found.summary.initial_cost
    np.testing.assert_allclose(found.iterations["cost"], expected.iterations["cost"], rtol=1e-9)
    np.testing.assert_allclose(found.factor_costs_after, expected.factor_costs_after, rtol=1e-5)


def test_a_solver_is_used_again():
    problem = rig_problem(rigs=(THREE,))
    options = {"refine_sensor_from_rig": True, "gauge": "two_cameras", "max_num_iterations": 4}
    solver = bundle.Solver(problem, **options)
    moved = problem.replace(rig_from_world=problem.rig_from_world + np.repeat([0, 0.01], [4, 3]))
    for start in (moved, problem):
        again, once = solver.solve(start), bundle.solve(start, **options)
        np.testing.assert_array_equal(again.iterations["cost"], once.iterations["cost"])
        np.testing.assert_array_equal(again.problem.sensor_from_rig, once.problem.sensor_from_rig)
        np.testing.assert_array_equal(again.problem.cam_from_world, once.problem.cam_from_world)


def test_far_from_the_origin():
    problem = rig_problem()
    far = np.array([5e5, -4e6, 100.0])
    frames = problem.rig_from_world.copy()
    frames[:, 4:] -= Rotation.from_quat(frames[:, :4]).apply(far)
    there = problem.replace(rig_from_world=frames, points=problem.points + far)
    near = bundle.solve(problem, gauge="none")
    found = bundle.solve(there, gauge="none")
    assert found.summary.final_cost == pytest.approx(near.summary.final_cost, rel=1e-6)
    bundle.Problem.replace(found.problem)


@pytest.mark.parametrize("gauge", ["none", "two_cameras", "three_points"])
@pytest.mark.parametrize("refined", [False, True])
def test_no_gauge_changes_the_optimum(gauge, refined):
    problem = rig_problem(rigs=(THREE,))
    options = {
        "refine_sensor_from_rig": refined,
        "refine": "poses,points",
        "function_tolerance": 1e-14,
        "gradient_tolerance": 1e-12,
        "parameter_tolerance": 1e-14,
    }
    free = bundle.solve(problem, gauge="none", **options)
    held = bundle.solve(problem, gauge=gauge, **options)
    assert held.summary.final_cost == pytest.approx(free.summary.final_cost, rel=1e-10)


def test_a_metric_rig_keeps_its_scale():
    problem = rig_problem(noise=0.1)
    shrunk = problem.replace(
        rig_from_world=problem.rig_from_world * [1, 1, 1, 1, 0.8, 0.8, 0.8],
        points=problem.points * 0.8,
    )
    sizes = []
    for start in (problem, shrunk):
        refined = bundle.solve(
            start, gauge="two_cameras", refine="poses,points", function_tolerance=1e-14
        ).problem
        sizes.append(np.linalg.norm(np.ptp(refined.projection_centers, axis=0)))
    assert sizes[1] == pytest.approx(sizes[0], rel=1e-6)


def test_fixed_sensors_that_do_not_exist():
    with pytest.raises(bundle.InputError, match=r"^fixed_sensors: .*rig 9, camera 2"):
        bundle.solve(rig_problem(), fixed_sensors=[(9, 2)])
