"""Distances between solutions, and the minima at which methods ended."""

import dataclasses
import shutil

import numpy as np
import pytest

import bundle
from bundle.interface.options import SolveOptions
from bundle.model.residuals import linearize
from bundle.model.rigid_motions import quaternion_from_vector, quaternion_multiply
from bundle.planning.comparison import process
from bundle.planning.comparison.compare_methods import compare
from bundle.planning.comparison.process import WorkerEnd
from bundle.planning.comparison.recommendation import SolutionDistance, find_minima
from tests.planning.comparison.fakes import CERES, DENSE, ITERATIVE, SPARSE, done, failed
from tests.scenes import make_problem

LOOSE = 1e-3


def moved(problem, rng, size, held):
    """Move all poses but the first `held`, and all points: (problem, tangent of poses, points)."""
    pose = size * rng.standard_normal((problem.num_images, 6))
    pose[:held] = 0
    point = size * rng.standard_normal((problem.num_points, 3))
    turned = quaternion_multiply(quaternion_from_vector(pose[:, :3]), problem.cam_from_world[:, :4])
    poses = np.concatenate([turned, problem.cam_from_world[:, 4:] + pose[:, 3:]], axis=1)
    changed = dataclasses.replace(problem, cam_from_world=poses, points=problem.points + point)
    return changed, pose, point


def dense_jacobian(problem):
    """Jacobian of all observations by poses (left perturbation) and points, in pixels."""
    found = linearize(problem)
    count = problem.num_observations
    jacobian = np.zeros((count, 2, 6 * problem.num_images + 3 * problem.num_points))
    for row in range(count):
        image, point = problem.observation_image[row], problem.observation_point[row]
        first = 6 * problem.num_images + 3 * point
        jacobian[row, :, 6 * image : 6 * image + 6] = found.d_pose[row]
        jacobian[row, :, first : first + 3] = found.d_point[row]
    return found.residual, jacobian


@pytest.mark.parametrize("loss", ["trivial", "cauchy"])
def test_distance_is_that_of_the_dense_covariance(tmp_path, loss):
    robust = {"loss": loss, "loss_scale": 0.7} if loss != "trivial" else {}
    options = SolveOptions(refine=("poses", "points"), **robust)
    best = bundle.solve(make_problem(num_images=4, num_points=30), options).problem
    other, pose, point = moved(best, np.random.default_rng(1), 1e-5, held=2)
    for name, problem in (("best", best), ("other", other)):
        process.store_solution(problem, tmp_path / name)
    residual, jacobian = dense_jacobian(best)
    squared = (residual**2).sum(axis=1)
    weight = 1 / (1 + squared / 0.7**2) if loss == "cauchy" else np.ones(len(squared))
    num_free = 6 * 4 - 7 + 3 * best.num_points
    redundancy = 2 * len(squared) - num_free
    sigma0 = np.sqrt(weight @ squared / redundancy)
    step = np.concatenate([pose.ravel(), point.ravel()])
    rows = np.sqrt(weight)[:, None, None] * jacobian
    rows = rows.reshape(-1, rows.shape[-1])
    covariance = sigma0**2 * np.linalg.pinv(rows.T @ rows, rcond=1e-12)
    projected = covariance @ np.linalg.pinv(covariance, rcond=1e-12) @ step  # without the gauge
    expected = np.sqrt(projected @ np.linalg.pinv(covariance, rcond=1e-12) @ projected)
    distance = SolutionDistance(best, options, tmp_path / "best", redundancy)
    found = distance.between(tmp_path / "other", tmp_path / "best").sigmas
    assert found == pytest.approx(expected, rel=1e-3)
    # The bound of every pose, with covariances of another implementation.
    marginal = bundle.covariance(best, options, gauge="two_cameras", scale="unit")
    for index in (2, 3):
        of_pose = sigma0**2 * marginal.pose(int(best.image_ids[index]))
        assert np.sqrt(pose[index] @ np.linalg.solve(of_pose, pose[index])) <= found * (1 + LOOSE)


def test_a_gap_of_the_cost_is_a_distance(tmp_path):
    problem = make_problem(num_images=5, num_points=60)
    best = bundle.solve(problem, function_tolerance=1e-14, gradient_tolerance=1e-14)
    early = bundle.solve(problem, max_num_iterations=1)
    process.store_solution(best.problem, tmp_path / "best")
    process.store_solution(early.problem, tmp_path / "early")
    summary = best.summary
    redundancy = summary.num_residuals_reduced - summary.num_parameters_reduced
    gap = early.summary.final_cost / summary.final_cost - 1
    distance = SolutionDistance(problem, SolveOptions(), tmp_path / "best", redundancy)
    found = distance.between(tmp_path / "early", tmp_path / "best").sigmas
    assert gap > 1e-5 and found == pytest.approx(np.sqrt(gap * redundancy), rel=0.05)


def test_other_gauge_no_distance(tmp_path):
    best = bundle.solve(make_problem(num_images=4, num_points=30)).problem
    process.store_solution(best, tmp_path / "best")
    scaled = dataclasses.replace(
        best,
        points=3 * best.points,
        cam_from_world=best.cam_from_world * np.array([1, 1, 1, 1, 3, 3, 3]),
    )
    process.store_solution(scaled, tmp_path / "scaled")
    distance = SolutionDistance(best, SolveOptions(), tmp_path / "best", 100)
    assert distance.between(tmp_path / "scaled", tmp_path / "best").sigmas < 1e-8


def test_data_without_noise_has_no_distant_solutions(tmp_path):
    exact = bundle.synthesize(num_images=4, num_points=40, pixel_noise=0.0).problem
    tight = bundle.solve(exact, function_tolerance=1e-15, gradient_tolerance=1e-15).problem
    usual = bundle.solve(exact).problem
    process.store_solution(tight, tmp_path / "tight")
    process.store_solution(usual, tmp_path / "usual")
    distance = SolutionDistance(exact, SolveOptions(), tmp_path / "tight", 100)
    assert distance.between(tmp_path / "usual", tmp_path / "tight").sigmas < 1


def test_single_points_at_other_positions_are_counted_and_left_out(tmp_path):
    best = bundle.solve(make_problem(num_images=4, num_points=1000)).problem
    process.store_solution(best, tmp_path / "best")
    distance = SolutionDistance(best, SolveOptions(), tmp_path / "best", 100)
    for number, counted in ((1, 1), (2, 2), (3, 0)):  # at most 0.2 % of the points
        points = best.points + 0.3 * (np.arange(1000) < number)[:, None]
        path = tmp_path / str(number)
        process.store_solution(dataclasses.replace(best, points=points), path)
        found = distance.between(path, tmp_path / "best")
        assert found.num_points == counted
        assert found.sigmas > 10 if counted == 0 else found.sigmas == 0


@pytest.fixture
def ended(tmp_path):
    """Find the minima of runs whose solutions, and whose continuations, are given offsets."""

    def find(ends, costs=None, refine=True):
        problem = make_problem(num_images=4, num_points=30)
        best = bundle.solve(problem)

        def write(offset, path):
            points = best.problem.points + [[offset, 0, 0]] * (np.arange(30) == 0)[:, None]
            process.store_solution(dataclasses.replace(best.problem, points=points), path)

        paths, stored = {}, {}
        for number, (method, (start, end)) in enumerate(ends.items()):
            paths[method] = tmp_path / f"{number}.npz"
            write(start, paths[method])
            if end is not None:
                stored[method] = tmp_path / f"end of {number}.npz"
                write(end, stored[method])

        def continued(run, target):
            if run.method not in stored:
                return WorkerEnd(outcome="timed_out")
            shutil.copy(stored[run.method], target)
            cost = run.final_cost + ends[run.method][1]
            summary = {"termination_type": "CONVERGENCE", "final_cost": cost}
            return WorkerEnd(outcome="done", measurement={"summary": summary})

        given = costs or [100.0 + number for number in range(len(ends))]
        runs = [done(method, cost=cost) for method, cost in zip(ends, given, strict=True)]
        runs.append(failed(CERES))
        paths[CERES] = tmp_path / "missing.npz"
        found = find_minima(problem, SolveOptions(), runs, paths, continued if refine else None)
        return [run.minimum for run in found], [run.distance_in_sigmas for run in found]

    return find


def test_near_solutions_need_no_continuation(ended):
    numbers, apart = ended({DENSE: (0, None), SPARSE: (1e-6, None)})
    assert numbers == [0, 0, -1]
    assert apart[0] == 0 < apart[1] < 1 and np.isnan(apart[2])


def test_an_early_stop_is_no_other_minimum(ended):
    numbers, apart = ended({DENSE: (0, 0), SPARSE: (0.5, 0), ITERATIVE: (0.5, 0.5)})
    assert numbers == [0, 0, 1, -1]
    assert apart[1] == pytest.approx(apart[2]) and apart[1] > 1


def test_the_continuation_with_the_lowest_cost_is_the_first_minimum(ended):
    # DENSE has the lowest cost, but SPARSE's continuation ends lower, somewhere else.
    numbers, _ = ended({DENSE: (0, 0), SPARSE: (0.5, -0.5)}, costs=[100.0, 100.2])
    assert numbers == [1, 0, -1]


def test_what_does_not_converge_has_no_minimum(ended):
    assert ended({DENSE: (0, 0), SPARSE: (0.5, None)})[0] == [0, -1, -1]
    assert ended({DENSE: (0, None), SPARSE: (0.5, 0)})[0] == [0, -1, -1]
    assert ended({DENSE: (0, 0), SPARSE: (0.5, 0.5)}, refine=False)[0] == [0, -1, -1]


@pytest.mark.usefixtures("unpredicted")
def test_runs_with_too_few_steps_are_at_one_minimum():
    comparison = compare(
        make_problem(num_images=5, num_points=60), solvers=["dense_schur", "iterative_schur"],
        backends=["fused"], threads=[1], repeat=1, perturb=0.05, max_num_iterations=2,
    )  # fmt: skip
    assert len(comparison.minima(0)) == 1 and len(comparison.minima(0)[0]) == 4
    assert max(run.distance_in_sigmas for run in comparison.runs) > 1
    assert comparison.recommendation is not None
