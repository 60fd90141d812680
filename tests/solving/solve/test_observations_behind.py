"""Observations that go behind their cameras: what they cost, and what a solve says of them.

The rule is derived at the top of core/factors/reprojection.h.
"""

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.model.residuals import reprojection_error, reprojection_errors
from tests import scenes
from tests.printed import figures, warning

BACKENDS = ("fused", "ceres")


def lossy():
    """Return a bad start of which an image can be turned away from all of its points."""
    return scenes.make_problem(
        num_images=5, num_points=30, model="SIMPLE_RADIAL", seed=9, perturbation=0.6, track=3
    )


def crossing():
    """Return a start from which observations go behind and come back, none of them behind."""
    return scenes.make_problem(
        num_images=6, num_points=60, model="EUCM", seed=16, perturbation=0.8, track=3
    )


def in_camera(problem, image, position):
    """Return the world point at a position in the frame of an image."""
    rotation = Rotation.from_quat(problem.cam_from_world[image, :4])
    return rotation.inv().apply(position - problem.cam_from_world[image, 4:])


def behind(problem):
    return reprojection_errors(problem, cheirality="zero")[1]


def cost_in_front(problem):
    errors, is_behind = reprojection_errors(problem, cheirality="zero")
    return 0.5 * float(np.sum(errors[~is_behind] ** 2))


@functools.cache
def solve_crossing(backend, **options):
    options = {"cheirality": "zero", "max_num_iterations": 22} | options
    return bundle.solve(crossing(), backend=backend, **options)


def test_an_image_is_not_turned_away(solve):
    problem = lossy()
    result = solve(problem, max_num_iterations=60)
    assert not behind(problem).any()
    assert not behind(result.problem).any()
    assert reprojection_error(result.problem).rmse < 1
    assert result.summary.final_cost == pytest.approx(cost_in_front(result.problem), rel=1e-6)
    assert result.summary.warning_kinds == ()


@pytest.mark.parametrize("loss", ["trivial", "huber"])
@pytest.mark.parametrize("strategy", ["levenberg_marquardt", "dogleg"])
def test_both_backends_take_the_same_steps(loss, strategy):
    options = {"loss": loss, "trust_region_strategy_type": strategy}
    if loss != "trivial":
        options["loss_scale"] = 30.0
    found, expected = (solve_crossing(backend, **options) for backend in BACKENDS)
    n = min(len(found.iterations["cost"]), 20)
    np.testing.assert_array_equal(
        found.iterations["step_is_successful"][:n], expected.iterations["step_is_successful"][:n]
    )
    good = expected.iterations["step_is_successful"][:n]
    levenberg = strategy == "levenberg_marquardt"
    costs = (result.iterations["cost"][:n][good] for result in (found, expected))
    np.testing.assert_allclose(*costs, rtol=1e-8 if levenberg else 1e-6)
    if levenberg:
        assert behind(expected.problem).any()
        assert behind(found.problem).tolist() == behind(expected.problem).tolist()


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_goes_behind_keeps_sixteen_times_its_cost(backend):
    """The first step that loses an observation: known from the state before it."""
    k, after = first_loss(backend)
    before = solve_crossing(backend, max_num_iterations=k - 1).problem
    lost = behind(after.problem)
    held = 16 * 0.5 * np.sum(reprojection_errors(before)[0][lost] ** 2)
    assert after.summary.final_cost == pytest.approx(cost_in_front(after.problem), rel=1e-9)
    assert after.summary.held_cost == pytest.approx(held, rel=1e-9)
    # The step is judged by both.
    change = cost_in_front(before) - cost_in_front(after.problem) - held
    assert after.iterations["cost_change"][-1] == pytest.approx(change, rel=1e-9)
    assert change > 0


def first_loss(backend, **options):
    """Return the number of the first step that loses observations, and the solve up to it."""
    for k in range(1, 23):
        result = solve_crossing(backend, max_num_iterations=k, **options)
        if behind(result.problem).any():
            return k, result
    raise AssertionError("no step loses any")


def test_what_is_held_is_in_sigmas_and_under_the_loss(backend):
    sigma = np.random.default_rng(0).uniform(5.0, 50.0, crossing().num_observations)
    problem = crossing().replace(observation_sigma=sigma)
    options = {"cheirality": "zero", "loss": "huber", "loss_scale": 2.0, "backend": backend}
    states = [problem]
    for k in range(1, 40):
        after = bundle.solve(problem, max_num_iterations=k, **options)
        lost = behind(after.problem)
        if lost.any():
            break
        states.append(after.problem)
    size = 4 * reprojection_errors(states[-1])[0][lost] / sigma[lost]
    held = np.where(size > 2, 2 * size - 2, size**2 / 2)
    assert after.summary.held_cost == pytest.approx(held.sum(), rel=1e-9)


def test_what_is_held_is_in_no_cost_of_an_iteration(backend):
    for k in range(1, 23):
        result = solve_crossing(backend, max_num_iterations=k)
        cost = result.iterations["cost"][result.iterations["step_is_successful"]]
        assert result.summary.final_cost == cost[-1]
        assert cost[-1] == pytest.approx(cost_in_front(result.problem), rel=1e-9)
    assert (result.summary.held_cost > 0) == behind(result.problem).any()


def passed_by():
    """Return a point in front of image 0 that three other images want a little behind it."""
    problem = scenes.make_problem(num_images=6, num_points=60, noise=0, perturbation=1e-3, seed=1)
    points, xy = problem.points.copy(), problem.observation_xy.copy()
    ray = np.array([0.05, 0.02, 1.0])
    start, end = (in_camera(problem, 0, depth * ray) for depth in (2.0, -0.1))
    for i in np.flatnonzero(problem.observation_point == 0):
        points[0] = start if problem.observation_image[i] == 0 else end
        seen = problem.replace(points=points, observation_xy=np.zeros_like(xy))
        xy[i] = scenes.residuals(seen)[i]
    xy[(problem.observation_point == 0) & (problem.observation_image == 0)] += 50.0
    points[0] = start
    keep = (problem.observation_point > 0) | ~np.isin(problem.observation_image, [1, 2])
    names = ("observation_image", "observation_point", "observation_keypoint")
    kept = {name: getattr(problem, name)[keep] for name in names}
    return problem.replace(points=points, observation_xy=xy[keep], **kept)


def test_what_is_held_is_no_part_of_a_tolerance(solve):
    """Beside what one observation holds, all that is left to gain is nothing."""
    problem = passed_by()
    assert not behind(problem).any()
    options = {"refine": "poses,points", "gauge": "two_cameras", "max_num_iterations": 200}
    exact = solve(problem, **options, function_tolerance=1e-12).summary
    summary = solve(problem, **options, function_tolerance=1e-3).summary
    assert summary.held_cost == pytest.approx(16 * 0.5 * 2 * 50.0**2, rel=1e-6)
    assert summary.final_cost < 1.0
    assert summary.final_cost == pytest.approx(exact.final_cost, rel=2e-2)
    assert summary.termination_type == "CONVERGENCE"
    share = float(summary.message.split(":")[1].split("<=")[0])
    assert share <= 1e-3


def test_both_costs_together_fall_from_step_to_step(backend):
    iterations = solve_crossing(backend).iterations
    assert (iterations["cost_change"][1:][iterations["step_is_successful"][1:]] > 0).all()


def test_lost_observations_are_counted_and_not_usable(backend):
    result = solve_crossing(backend)
    problem = crossing()
    num_lost = int(behind(result.problem).sum())
    assert num_lost > 0.01 * problem.num_observations
    assert not result.summary.is_solution_usable
    assert result.summary.warning_kinds == ("observations_behind", "too_many_behind")
    behind_in_all, lost = map(figures, result.summary.warnings)
    assert behind_in_all[:3] == [str(num_lost), str(problem.num_observations), "0"]
    assert lost[:2] == [str(problem.num_observations), str(num_lost)]


def test_an_image_with_none_in_front_is_named(solve):
    """Its pose is kept, and so are the points: nothing can bring them back."""
    problem = scenes.make_problem(num_images=5, num_points=40, track=3)
    poses = problem.cam_from_world.copy()
    about = Rotation.from_quat([1, 0, 0, 0]) * Rotation.from_quat(poses[2, :4])
    poses[2, :4] = about.as_quat()
    poses[2, 4:] *= [1, -1, -1]
    problem = problem.replace(cam_from_world=poses)
    result = solve(problem, max_num_iterations=5)
    sentence = warning(result.summary, "observations_behind")
    assert f"image {problem.image_ids[2]} " in sentence


def test_one_behind_at_the_start_costs_nothing_and_blocks_no_step(solve):
    """A camera too far ahead, so that its nearest point is right behind it."""
    problem = scenes.make_problem(num_images=5, num_points=60, seed=4, noise=0.3)
    poses = problem.cam_from_world.copy()
    rotation = Rotation.from_quat(poses[0, :4])
    poses[0, 6] -= (rotation.apply(problem.points.copy()) + poses[0, 4:])[:, 2].min() + 1e-9
    problem = problem.replace(cam_from_world=poses)
    assert behind(problem).sum() == 1
    result = solve(problem)
    assert result.summary.initial_cost == pytest.approx(cost_in_front(problem), rel=1e-9)
    assert result.summary.termination_type == "CONVERGENCE"
    assert result.summary.is_solution_usable
    assert not behind(result.problem).any()
    assert reprojection_error(result.problem).rmse < 0.36
    # Once it is in front it counts, and the solve goes on.
    assert result.summary.warning_kinds == ()
    assert result.summary.final_cost == pytest.approx(cost_in_front(result.problem), rel=1e-9)
    again = solve(result.problem)
    assert again.summary.final_cost == pytest.approx(result.summary.final_cost, rel=1e-6)
    assert len(again.iterations["cost"]) <= 2
    numbers = result.iterations["iteration"]
    assert numbers.tolist() == list(range(len(numbers)))
    assert (np.diff(result.iterations["cumulative_time_in_seconds"]) >= 0).all()
    # Without room to go on it says so.
    anew = int(np.flatnonzero(result.iterations["step_norm"][1:] == 0)[0]) + 1
    assert result.iterations["cost"][anew] > result.iterations["cost"][anew - 1]
    short = solve(problem, max_num_iterations=anew - 1)
    assert figures(warning(short.summary, "observations_left_out")) == ["1"]
    assert short.summary.final_cost == short.iterations["cost"][-1]


def test_points_at_a_camera_centre_do_not_block(solve):
    problem = scenes.make_problem(num_images=6, num_points=60, seed=2, noise=0.5)
    points = problem.points.copy()
    rays = np.random.default_rng(3).uniform(-0.2, 0.2, (20, 3))
    rays[:, 2] = 1
    points[:20] = in_camera(problem, 0, 1e-9 * rays)
    problem = problem.replace(points=points)
    assert not behind(problem).any()
    result = solve(problem, max_num_iterations=30)
    assert result.summary.final_cost < 0.05 * result.summary.initial_cost
    assert behind(result.problem).sum() <= 0.01 * problem.num_observations


def test_deterministic_with_observations_behind():
    one, two = (
        bundle.solve(
            crossing(), backend="fused", deterministic=True, num_threads=n, max_num_iterations=22
        )
        for n in (1, 2)
    )
    assert behind(one.problem).any()
    assert one.iterations["cost"].tolist() == two.iterations["cost"].tolist()
    assert one.problem.points.tolist() == two.problem.points.tolist()


def test_algebraic_residuals_stay_what_they_are(solve):
    problem = crossing()
    result = solve(problem, cheirality="algebraic", max_num_iterations=8)
    errors = reprojection_errors(result.problem)[0]
    expected = 0.5 * np.nansum(errors**2)
    assert result.summary.final_cost == pytest.approx(expected, rel=1e-9)


def test_a_panorama_whose_points_are_at_its_cameras(bundle_data):
    """1,354 of its points are; step 81 sent all of their 15,590 observations behind."""
    problem = bundle.load(bundle_data / "degenerate" / "pratikk0")
    before = reprojection_error(problem)
    result = bundle.solve(
        problem,
        backend="fused",
        function_tolerance=1e-10,
        parameter_tolerance=0,
        max_num_iterations=85,
    )
    after = reprojection_error(result.problem)
    assert after.num_behind_camera <= 0.01 * problem.num_observations
    assert after.rmse <= before.rmse
    assert result.summary.is_solution_usable
    assert result.summary.final_cost == pytest.approx(cost_in_front(result.problem), rel=1e-6)
