"""Statistics on the same observations, against plain NumPy; the claim of a minimum."""

import dataclasses

import numpy as np
import pytest

from bundle.solving.headline import is_at_minimum
from bundle.solving.kept_errors import Deleted, Edit, PixelErrors, measure, outlier_limit
from bundle.solving.measured_result import Movement
from tests.reports.terminal import fakes
from tests.scenes import make_problem, with_observations


def drawn(seed, count=200):
    """Errors, of which some are missing, and observations behind their camera."""
    rng = np.random.default_rng(seed)
    errors = rng.gamma(2.0, 1.0, count)
    errors[rng.random(count) < 0.05] = np.nan
    return PixelErrors(errors, rng.random(count) < 0.1, "zero")


@pytest.mark.parametrize("limit", [None, 3.0])
@pytest.mark.parametrize("is_cut", [False, True])
def test_statistics_are_those_of_the_observations_that_count_on_both_sides(limit, is_cut):
    before, after = drawn(0), drawn(1)
    kept = np.random.default_rng(2).random(200) < 0.8 if is_cut else None
    start = before if kept is None else PixelErrors(before.errors[kept], before.behind[kept], "")
    end = after if kept is None else PixelErrors(after.errors[kept], after.behind[kept], "zero")
    counts = ~np.isnan(start.errors) & ~start.behind & ~np.isnan(end.errors) & ~end.behind
    first, last = start.errors[counts], end.errors[counts]
    behind = int(start.behind.sum()), int(end.behind.sum())
    everything = before.errors[~np.isnan(before.errors) & ~before.behind]
    found = measure(PixelErrors(*map(np.copy, before[:2]), "zero"), end, kept, limit)
    for one, values in ((found.kept.before, first), (found.kept.after, last)):
        assert one.rmse == pytest.approx(np.sqrt(np.mean(values**2)))
        assert one.median == pytest.approx(np.median(values))
        assert one.num_observations == len(values)
    assert (found.kept.before.num_behind_camera, found.kept.after.num_behind_camera) == behind
    assert found.kept.num_observations == len(end.errors)
    assert found.before.rmse == pytest.approx(np.sqrt(np.mean(everything**2)))
    if limit is None:
        assert found.kept.inliers is None
        return
    inliers, both = found.kept.inliers, (first <= limit) & (last <= limit)
    assert inliers.num_outliers == (last > limit).sum()
    assert inliers.rmse == pytest.approx(np.sqrt(np.mean(last[last <= limit] ** 2)))
    assert inliers.num_inliers == both.sum() < (last <= limit).sum()
    assert inliers.rmse_before == pytest.approx(np.sqrt(np.mean(first[both] ** 2)))
    assert inliers.rmse_after == pytest.approx(np.sqrt(np.mean(last[both] ** 2)))


def test_nothing_is_compared_without_a_projection_on_both_sides():
    gone = PixelErrors(np.full(3, np.nan), np.ones(3, bool), "zero")
    found = measure(gone, PixelErrors(np.ones(3), np.zeros(3, bool), "zero"), None, 2.0)
    assert found.kept.before.num_observations == 0 and np.isnan(found.kept.after.rmse)
    assert found.after.rmse == 1 and np.isnan(found.kept.inliers.rmse_after)


def test_an_image_without_observations_is_deleted():
    problem = make_problem(num_images=4)
    left = with_observations(problem, problem.observation_image != 2)
    assert Deleted.of(problem, problem) == Deleted()
    assert Deleted.of(problem, left) == Deleted(num_observations=40, num_images=1)


def test_outliers_need_a_loss_in_pixels():
    problem = make_problem()
    robust = fakes.OPTIONS.replace(loss="huber", loss_scale=2.0)
    assert outlier_limit(problem, fakes.OPTIONS) is None
    assert outlier_limit(problem, robust) == 6.0
    sigmas = np.ones(problem.num_observations)
    assert outlier_limit(problem.replace(observation_sigma=sigmas), robust) is None


STILL = {
    "num_images": 4,
    "position": 1e-5,
    "largest_position": 1e-4,
    "rotation": 1e-5,
    "scene_size": 1.0,
    "num_cameras": 1,
    "focal": 1e-6,
}


@pytest.mark.parametrize(
    ("change", "claimed"),
    [
        ({}, True),
        ({"final_cost": 99.999}, True),
        ({"final_cost": 99.98}, False),
        ({"initial_cost": 0.0, "final_cost": 0.0}, True),
        ({"termination_type": "NO_CONVERGENCE"}, False),
        ({"message": "Function tolerance reached. No non-constant parameter blocks"}, False),
        ({"radius": 1e-3}, False),
        ({"position": 2e-3}, False),
        ({"focal": 2e-3}, False),
        ({"position": np.nan, "num_images": 0, "focal": np.nan}, True),
        ({"edit": "camera_model"}, False),
        ({"edit": "alignment"}, True),
    ],
)
def test_a_minimum_needs_little_cost_little_motion_and_long_steps(change, claimed):
    problem = make_problem()
    names = {field.name for field in dataclasses.fields(fakes.CONVERGED)}
    summary = {"initial_cost": 100.0, "final_cost": 100.0}
    summary |= {name: value for name, value in change.items() if name in names}
    iterations = fakes.iterations() | {"trust_region_radius": np.array([change.get("radius", 1e4)])}
    edits = (Edit(change["edit"], problem, problem),) if "edit" in change else ()
    solved = fakes.result(
        problem, summary=fakes.summary(**summary), iterations=iterations, edits=edits
    )
    moved = STILL | {name: value for name, value in change.items() if name in STILL}
    vars(solved)["movement"] = Movement(**moved)
    assert is_at_minimum(solved) == claimed
