"""Images that turn further than a chart goes: both backends take the same steps, and arrive."""

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests import scenes
from tests.solving.fused.measured_steps import first_measured

# Of an image whose rotation is wrong by 60 to 180 degrees; the others and most points are held.
SEEDS = (9, 56, 69)
STRATEGIES = ("levenberg_marquardt", "dogleg", "subspace_dogleg")
OPTIONS = {
    "refine": "poses,points",
    "fixed_image_ids": (2, 3),
    "fixed_point_ids": tuple(range(3, 41)),
    "gauge": "none",
    "linear_solver_type": "dense_schur",
    "max_num_iterations": 60,
    "function_tolerance": 1e-10,
    "num_threads": 1,
}


def good_start():
    return scenes.make_problem(num_images=3, num_points=40)


def wild_start(seed):
    rng = np.random.default_rng(seed)
    problem = good_start()
    poses = problem.cam_from_world.copy()
    axis = rng.standard_normal(3)
    turn = rng.uniform(1, np.pi) * axis / np.linalg.norm(axis)
    poses[0, :4] = (Rotation.from_rotvec(turn) * Rotation.from_quat(poses[0, :4])).as_quat()
    return problem.replace(cam_from_world=poses)


@functools.cache
def solve(seed, strategy, backend="fused", steps=OPTIONS["max_num_iterations"]):
    options = {**OPTIONS, "trust_region_strategy_type": strategy, "max_num_iterations": steps}
    return bundle.solve(wild_start(seed), backend=backend, **options)


def largest_turn(seed, strategy):
    """Rotation parts of the accepted steps: their norms without translation and points."""
    largest = 0.0
    iterations = solve(seed, strategy).iterations
    for k in 1 + np.flatnonzero(iterations["step_is_successful"][1:]):
        norm = iterations["step_norm"][k]
        if norm < 2 * np.pi:
            continue
        before, after = (solve(seed, strategy, steps=int(steps)).problem for steps in (k - 1, k))
        moved = np.sum((after.cam_from_world[:, 4:] - before.cam_from_world[:, 4:]) ** 2)
        moved += np.sum((after.points - before.points) ** 2)
        largest = max(largest, np.sqrt(max(norm**2 - moved, 0)))
    return largest


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("seed", SEEDS)
def test_same_steps_as_ceres_far_out(seed, strategy):
    found, expected = (solve(seed, strategy, backend) for backend in ("fused", "ceres"))
    assert len(found.iterations["cost"]) == len(expected.iterations["cost"])
    for name in ("cost", "gradient_max_norm", "step_norm", "trust_region_radius"):
        values = np.asarray(expected.iterations[name])
        unit = np.maximum(values, 1e-3 * values.max() if name != "cost" else 0)
        begin = first_measured(expected.iterations) if name == "step_norm" else 0
        difference = np.abs(found.iterations[name] - values)
        assert np.all((difference <= 1e-9 * unit)[begin:]), name
    for result in (found, expected):
        assert result.summary.termination_type == "CONVERGENCE"
        assert result.summary.final_cost == pytest.approx(
            bundle.solve(good_start(), **OPTIONS).summary.final_cost, rel=1e-8
        )
        assert not result.summary.warnings
    np.testing.assert_allclose(
        found.problem.cam_from_world, expected.problem.cam_from_world, atol=1e-9
    )


def test_steps_leave_the_chart():
    """A step of more than a turn starts or ends more than half a turn away from the start."""
    turns = [largest_turn(seed, strategy) for seed in SEEDS for strategy in STRATEGIES]
    assert np.sum(np.array(turns) > 2 * np.pi) > 6


def test_a_solver_starts_anew_after_a_wild_solve():
    problem = wild_start(SEEDS[0])
    expected = solve(SEEDS[0], "levenberg_marquardt")
    solver = bundle.Solver(problem, backend="fused", **OPTIONS)
    for _ in range(2):
        found = solver.solve(problem)
        np.testing.assert_array_equal(found.iterations["cost"], expected.iterations["cost"])
        np.testing.assert_array_equal(found.problem.cam_from_world, expected.problem.cam_from_world)
