"""Solves against minima and costs that are computed independently."""

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests import scenes
from tests.solving.solve.problems import FUSED_SOLVERS, LOSSES, cost, minimum_by_scipy

SOLVERS = [
    "auto",
    "dense_schur",
    "sparse_schur",
    "iterative_schur",
    "dense_normal_cholesky",
    "sparse_normal_cholesky",
    "dense_qr",
    "cgnr",
]
CONVERGED = {
    "function_tolerance": 1e-14,
    "gradient_tolerance": 1e-9,
    "parameter_tolerance": 1e-14,
    "max_num_iterations": 300,
}


@functools.cache
def problem_and_its_minimum(shared):
    problem = scenes.make_problem(num_images=3, num_points=12, shared=shared, seed=1)
    return problem, minimum_by_scipy(problem)


@pytest.mark.parametrize("shared", [False, True])
def test_reaches_the_minimum_that_scipy_finds(solve, shared):
    problem, expected = problem_and_its_minimum(shared)
    result = solve(problem, gauge="none", **CONVERGED)
    assert result.summary.initial_cost == pytest.approx(cost(problem), rel=1e-12)
    assert result.summary.final_cost == pytest.approx(cost(result.problem), rel=1e-10)
    assert result.summary.final_cost == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("solver", sorted(set(SOLVERS) - set(FUSED_SOLVERS)))
def test_the_fused_backend_refuses_solvers_that_it_does_not_know(solver):
    with pytest.raises(bundle.InputError, match=r"^linear_solver_type: .* fused .* found"):
        bundle.solve(scenes.make_problem(), backend="fused", linear_solver_type=solver)


@functools.cache
def problem_and_reference(model):
    # Twelve numbers of distortion from one small image have several minima.
    shared = len(bundle.camera_models()[model]) > 8
    problem = scenes.make_problem(model=model, seed=2, shared=shared)
    reference = bundle.solve(
        problem, backend="ceres", linear_solver_type="dense_schur", **CONVERGED
    )
    return problem, reference.summary.final_cost


# The fused backend has code for each number of parameters, Ceres for each solver.
@pytest.mark.parametrize(
    ("model", "backend", "solver"),
    [
        (model, backend, solver)
        for i, model in enumerate(sorted(bundle.camera_models()))
        for backend, solvers, every in (("fused", FUSED_SOLVERS, 2), ("ceres", SOLVERS, 4))
        for k, solver in enumerate(solvers)
        if (i + k) % every == 0
    ],
)
def test_every_solver_reaches_the_same_minimum(model, backend, solver):
    problem, expected = problem_and_reference(model)
    result = bundle.solve(problem, backend=backend, linear_solver_type=solver, **CONVERGED)
    assert result.summary.is_solution_usable
    assert result.summary.final_cost == pytest.approx(expected, rel=1e-5)
    assert result.summary.final_cost < 0.1 * result.summary.initial_cost


@pytest.mark.parametrize("strategy", ["levenberg_marquardt", "dogleg", "subspace_dogleg"])
@pytest.mark.parametrize("ordering", ["points_first", "cameras_first", "automatic"])
def test_every_strategy_and_ordering_reaches_the_same_minimum(solve, backend, strategy, ordering):
    problem = scenes.make_problem(shared=True, seed=3)
    if backend == "fused" and ordering != "points_first":
        with pytest.raises(bundle.InputError, match=r"^linear_solver_ordering: .* fused .* found"):
            solve(problem, linear_solver_ordering=ordering)
        return
    reference = bundle.solve(
        problem, backend="ceres", linear_solver_type="dense_schur", **CONVERGED
    )
    result = solve(
        problem,
        linear_solver_type="sparse_schur",
        linear_solver_ordering=ordering,
        trust_region_strategy_type=strategy,
        **CONVERGED,
    )
    assert result.summary.final_cost == pytest.approx(reference.summary.final_cost, rel=1e-6)


@pytest.mark.parametrize("loss", sorted(LOSSES))
@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_losses_cost_what_their_formulas_say(solve, loss, scale):
    problem = scenes.make_problem(seed=4, perturbation=2e-3)
    scaled = {} if loss == "trivial" else {"loss_scale": scale}
    result = solve(problem, loss=loss, **scaled, max_num_iterations=5)
    assert result.summary.initial_cost == pytest.approx(cost(problem, loss, scale), rel=1e-10)
    assert result.summary.final_cost == pytest.approx(cost(result.problem, loss, scale), rel=1e-10)
    assert result.summary.final_cost < result.summary.initial_cost


def test_a_robust_loss_resists_outliers(solve):
    clean = scenes.make_problem(seed=5, noise=0.1, num_points=60)
    xy = clean.observation_xy.copy()
    xy[::50] += 200
    spoiled = clean.replace(observation_xy=xy)
    truth = solve(clean).problem
    robust = solve(spoiled, loss="cauchy", loss_scale=1.0).problem
    plain = solve(spoiled).problem
    error = [
        np.abs(p.cam_from_world[:, 4:] - truth.cam_from_world[:, 4:]).max() for p in (robust, plain)
    ]
    assert error[0] < 0.02 * error[1]


def test_the_input_is_untouched_and_what_did_not_change_is_shared(solve):
    problem = scenes.make_problem(seed=6)
    before = {name: getattr(problem, name).copy() for name in ("cam_from_world", "points")}
    result = solve(problem)
    for name, array in before.items():
        assert (getattr(problem, name) == array).all()
        assert not (getattr(result.problem, name) == array).all()
    assert np.shares_memory(result.problem.observation_xy, problem.observation_xy)


def test_zero_iterations_keep_every_bit(solve):
    problem = scenes.make_problem(seed=7)
    poses = problem.cam_from_world * np.array([1.1] * 4 + [1.0] * 3)  # not normalised
    problem = problem.replace(cam_from_world=poses)
    result = solve(problem, max_num_iterations=0)
    for name in ("cam_from_world", "points", "camera_params"):
        assert (getattr(result.problem, name) == getattr(problem, name)).all()
    assert result.summary.final_cost == result.summary.initial_cost


def test_the_same_solve_twice_gives_the_same_bits_on_one_thread(solve):
    problem = scenes.make_problem(seed=8)
    first = solve(problem, num_threads=1)
    second = solve(problem, num_threads=1)
    assert (first.problem.points == second.problem.points).all()
    assert (first.iterations["cost"] == second.iterations["cost"]).all()


def test_large_rotations_come_out_right():
    truth = scenes.make_problem(seed=9, perturbation=0, noise=0)
    turns = np.random.default_rng(9).standard_normal((truth.num_images, 3))
    turns *= 0.7 / np.linalg.norm(turns, axis=1)[:, None]
    poses = truth.cam_from_world.copy()
    start = Rotation.from_rotvec(turns) * Rotation.from_quat(poses[:, :4])
    poses[:, :4] = start.as_quat()
    problem = truth.replace(cam_from_world=poses)
    result = bundle.solve(problem, refine="poses", cheirality="algebraic", **CONVERGED)
    assert cost(result.problem) < 1e-15
    found = Rotation.from_quat(result.problem.cam_from_world[:, :4])
    expected = Rotation.from_quat(truth.cam_from_world[:, :4])
    assert (found.inv() * expected).magnitude().max() < 1e-9
    norms = np.linalg.norm(result.problem.cam_from_world[:, :4], axis=1)
    np.testing.assert_allclose(norms, 1, atol=1e-14)


def test_iterations_are_ceres_records(solve):
    result = solve(scenes.make_problem(seed=10))
    iterations = result.iterations
    assert set(iterations) == {
        "iteration",
        "cost",
        "cost_change",
        "gradient_max_norm",
        "step_norm",
        "relative_decrease",
        "trust_region_radius",
        "linear_solver_iterations",
        "step_is_successful",
        "iteration_time_in_seconds",
        "cumulative_time_in_seconds",
    }
    assert iterations["iteration"].tolist() == list(range(len(iterations["cost"])))
    assert iterations["cost"][0] == result.summary.initial_cost
    assert iterations["cost"].min() == pytest.approx(result.summary.final_cost, rel=1e-12)
    assert (np.diff(iterations["cumulative_time_in_seconds"]) >= 0).all()


def test_the_reprojection_error_is_per_observation(solve):
    problem = scenes.make_problem(seed=11)
    result = solve(problem)
    n = problem.num_observations
    assert result.reprojection_error_before.rmse == pytest.approx(
        np.sqrt(2 * result.summary.initial_cost / n), rel=1e-10
    )
    assert result.reprojection_error_after.rmse == pytest.approx(
        np.sqrt(2 * result.summary.final_cost / n), rel=1e-10
    )
    assert result.initial_problem is problem
    assert result.reprojection_error_after is result.reprojection_error_after  # measured once


def test_conjugate_gradients_survive_a_reduced_system_of_one_column(solve):
    problem = scenes.make_problem(shared=True, seed=12)
    options = {"refine": "points,focal", **CONVERGED}
    expected = solve(problem, linear_solver_type="dense_schur", **options).summary
    found = solve(problem, linear_solver_type="iterative_schur", **options).summary
    assert found.is_solution_usable
    assert found.final_cost == pytest.approx(expected.final_cost, rel=1e-8)


@pytest.mark.parametrize(
    "preconditioner",
    ["identity", "jacobi", "schur_jacobi", "schur_power_series_expansion", "two_level"],
)
def test_every_preconditioner_of_the_fused_backend_reaches_the_same_minimum(preconditioner):
    problem = scenes.make_problem(seed=13, shared=True)
    options = {"linear_solver_type": "iterative_schur", "preconditioner_type": preconditioner}
    expected = bundle.solve(problem, backend="ceres", **CONVERGED).summary
    found = bundle.solve(problem, backend="fused", **options, **CONVERGED).summary
    assert found.preconditioner_type_used == preconditioner.upper()
    assert found.final_cost == pytest.approx(expected.final_cost, rel=1e-8)
