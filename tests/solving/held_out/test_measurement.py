"""Held-out errors of a solve: a second fit, against a fit by hand."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.model.residuals import summarize_clipped
from bundle.solving.hold_out import choose, with_values
from tests.georeference.flights import flight
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem, with_observations
from tests.solving.ranks.thread_crew import processes

TIGHT = {"function_tolerance": 1e-13, "gradient_tolerance": 1e-11, "parameter_tolerance": 1e-13}
FIXED = {"deterministic": True, "num_threads": 1}


def photographs(**changes):
    """Return 8 images of 150 points in most of them, with a few outliers."""
    rng = np.random.default_rng(4)
    problem = make_problem(num_images=8, num_points=150, **changes)
    problem = with_observations(problem, rng.random(problem.num_observations) < 0.7)
    xy = problem.observation_xy.copy()
    xy[rng.choice(len(xy), 8, replace=False)] += 25
    return problem.replace(observation_xy=xy)


def by_hand(problem, percent=10.0, seed=0, **options):
    """Return errors of the fit without the held-out observations, from the input, and a mask."""
    kept, rows = bundle.hold_out(problem, percent, seed)
    fitted = bundle.solve(kept, **options).problem
    errors, behind = bundle.reprojection_errors(with_values(problem, fitted))
    assert not behind.any()
    held = np.zeros(problem.num_observations, bool)
    held[rows] = True
    return errors, held


@pytest.mark.parametrize("loss", ["trivial", "cauchy"])
def test_errors_are_those_of_a_fit_by_hand(backend, loss):
    problem = photographs()
    options = {"backend": backend, "loss": loss, **TIGHT}
    result = bundle.solve(problem, hold_out=10, hold_out_seed=5, **options)
    errors, held = by_hand(problem, 10, 5, **options)
    found = result.held_out
    for part, mask in ((found, held), (found.fitted, ~held)):
        expected = dataclasses.asdict(summarize_clipped(errors[mask]))
        got = {name: getattr(part, name) for name in expected}
        assert got == pytest.approx(expected, rel=1e-6)
    assert (found.percent, found.seed, found.is_converged) == (10, 5, True)
    assert found.clipped_rmse > found.fitted.clipped_rmse
    assert "Held out 10 %" in repr(result)


def test_the_result_is_that_without_holding_out():
    problem = photographs()
    plain, held = bundle.solve(problem, **FIXED), bundle.solve(problem, hold_out=20, **FIXED)
    np.testing.assert_array_equal(held.problem.points, plain.problem.points)
    assert held.summary.final_cost == plain.summary.final_cost
    assert held.problem.num_observations == problem.num_observations
    assert plain.held_out is None
    rounds = {"num_rounds": 2, "max_error": 3.0, **FIXED}
    plain = bundle.solve_rounds(problem, **rounds)
    held = bundle.solve_rounds(problem, hold_out=20, **rounds)
    np.testing.assert_array_equal(held.problem.points, plain.problem.points)
    assert [r.num_points for r in held.rounds] == [r.num_points for r in plain.rounds]


def test_observations_that_rounds_remove_keep_their_errors():
    problem = photographs()
    options = {"hold_out": 10, "function_tolerance": 1e-10, "loss": "cauchy"}
    kept = bundle.solve_rounds(problem, num_rounds=0, **options).held_out
    cut = bundle.solve_rounds(problem, num_rounds=3, max_error=2.0, min_angle=0, **options).held_out
    for found, other in ((cut, kept), (cut.fitted, kept.fitted)):
        assert found.num_observations == other.num_observations
        assert found.num_without_projection == other.num_without_projection == 0
        assert found.clipped_rmse == pytest.approx(other.clipped_rmse, rel=0.05)
    assert cut.fitted.share_clipped >= 4 / cut.fitted.num_observations  # the outliers


def test_deleted_points_are_triangulated_again_from_what_is_not_held_out():
    """Deleting most points for their tracks leaves the cameras, and with them the predictions."""
    problem = photographs()
    options = {"hold_out": 10, "num_rounds": 1, "loss": "cauchy", **FIXED}
    few = bundle.solve_rounds(problem, min_track_length=7, min_angle=0, **options)
    assert few.problem.num_points < 0.4 * problem.num_points
    assert few.held_out.num_without_projection == 0
    # The second fit by hand: it begins where the first one ended, without the held-out rows.
    held = choose(problem, 10.0, 0)
    points = problem.points.copy()
    mask = np.isin(problem.point_ids, few.problem.point_ids)
    points[mask] = few.problem.points
    values = {"camera_params": few.problem.camera_params, "points": points}
    start = problem.replace(cam_from_world=few.problem.cam_from_world, **values)
    second = bundle.solve_rounds(
        start.select(observations=~held).problem, min_track_length=7, min_angle=0, num_rounds=1,
        loss="cauchy", **FIXED,
    ).problem  # fmt: skip
    cameras = {name: getattr(second, name) for name in ("cam_from_world", "camera_params")}
    full = problem.replace(**cameras)
    again = bundle.solve(
        full.select(observations=~held).problem, refine=("points",), loss="cauchy", **TIGHT
    ).problem
    errors, _ = bundle.reprojection_errors(full.replace(points=again.points))
    expected = summarize_clipped(errors[held])
    assert few.held_out.clipped_rmse == pytest.approx(expected.clipped_rmse, rel=0.02)
    assert few.held_out.median == pytest.approx(expected.median, rel=0.05)


@pytest.mark.parametrize("rest", ["fixed", "marginal"])
def test_local_adjustment_holds_out_observations_of_its_images(rest):
    problem = photographs()
    local = {"num_rounds": 0, "only_images": [1, 2], "rest": rest}
    result = bundle.solve_rounds(problem, hold_out=10, **local, **FIXED)
    plain = bundle.solve_rounds(problem, **local, **FIXED)
    np.testing.assert_array_equal(result.problem.cam_from_world, plain.problem.cam_from_world)
    seen = int((problem.observation_image < 2).sum())
    assert result.held_out.num_observations + result.held_out.fitted.num_observations == seen
    assert result.held_out.num_observations == pytest.approx(0.1 * seen, abs=1)


def test_control_points_keep_their_measurements_and_the_frame_stays():
    scene = flight([[-20, 0, 0], [20, 3, 1], [0, 25, 0.5], [5, -22, 0]], noise=0.5)
    problem = scene.elsewhere()
    options = {"priors": scene.gcps, **TIGHT}
    result = bundle.solve(problem, hold_out=10, **options)
    found = result.held_out
    assert found.num_observations + found.fitted.num_observations == problem.num_observations
    placed = bundle.solve(problem, **options)
    kept, _ = bundle.hold_out(placed.problem, 10)
    refined = bundle.solve(kept, align=False, **options).problem
    errors, _ = bundle.reprojection_errors(with_values(problem, refined))
    held = choose(problem, 10)
    assert found.median == pytest.approx(np.median(errors[held]), rel=1e-5)


def test_priors_of_rules_stay_at_the_values_of_the_input():
    """A prior relative to the start does not follow the second fit's start."""
    problem = photographs(model="SIMPLE_RADIAL", shared=True)
    start = problem.camera_params.copy()
    start[:, 0] *= 1.2
    problem = problem.replace(camera_params=start)
    options = {"constraints": ["cameras *: f prior 0.01 %"], **TIGHT}
    errors, held = by_hand(problem, **options)
    found = bundle.solve(problem, hold_out=10, **options).held_out
    assert found.median == pytest.approx(np.median(errors[held]), rel=1e-5)


def test_rigs_and_a_far_start():
    problem = rig_problem(num_alone=2)
    found = bundle.solve(problem, hold_out=10, refine_sensor_from_rig=True, **TIGHT).held_out
    kept, rows = bundle.hold_out(problem, 10)
    refined = bundle.solve(kept, refine_sensor_from_rig=True, **TIGHT).problem
    errors, _ = bundle.reprojection_errors(with_values(problem, refined))
    assert found.median == pytest.approx(np.median(errors[rows]), rel=1e-5)


def test_several_processes():
    problem = photographs()
    alone = bundle.solve(problem, hold_out=10, num_threads=1, **TIGHT)
    with processes(3):
        divided = bundle.solve(problem, hold_out=10, num_threads=1, **TIGHT)
    assert divided.held_out.clipped_rmse == pytest.approx(alone.held_out.clipped_rmse, rel=1e-8)


def test_resumed_run_measures_as_well(tmp_path):
    problem, file = photographs(), tmp_path / "run.ckpt"
    options = {"num_rounds": 2, "hold_out": 10, **FIXED}
    whole = bundle.solve_rounds(problem, checkpoint=file, **options)
    again = bundle.solve_rounds(problem, resume=file, **options)
    assert again.held_out == whole.held_out


def test_unfinished_solves_have_no_held_out_errors():
    problem = photographs()

    def stop(_):
        raise KeyboardInterrupt

    assert bundle.solve(problem, hold_out=10, progress=stop).held_out is None
    short = bundle.solve(problem, hold_out=10, max_num_iterations=1).held_out
    assert not short.is_converged


def test_an_interrupted_second_fit_leaves_the_first():
    problem, starts = photographs(), []

    def stop_second(step):
        starts.extend([0] * (step["iteration"] == 0))
        if len(starts) == 2:
            raise KeyboardInterrupt

    result = bundle.solve(problem, hold_out=10, progress=stop_second)
    assert len(starts) == 2
    assert result.held_out is None
    assert not result.summary.interrupted


def test_bad_requests_fail_before_the_solve():
    problem = make_problem(num_images=6, num_points=60, track=2)

    def never(_):
        raise AssertionError

    with pytest.raises(bundle.InputError, match=r"^hold_out: expected images"):
        bundle.solve(problem, hold_out=10, progress=never)
    with pytest.raises(bundle.InputError, match=r"^hold_out: expected"):
        bundle.solve(problem, hold_out=60)
    with pytest.raises(bundle.InputError, match=r"^hold_out_seed: expected"):
        bundle.solve(problem, hold_out=10, hold_out_seed=-1)
