"""Statistics of errors that are limited to a clip."""

import numpy as np
import pytest

from bundle.model.residuals import errors_or_nan, summarize_clipped
from tests.scenes import make_problem


def test_statistics_by_hand():
    found = summarize_clipped(np.array([1.0, np.nan, 3.0, 10.0, 2.0]), clip=4.0)
    assert found.rmse == pytest.approx(np.sqrt((1 + 9 + 100 + 4) / 4))
    assert found.median == 3.0
    assert found.clipped_rmse == pytest.approx(np.sqrt((1 + 16 + 9 + 16 + 4) / 5))
    assert (found.share_clipped, found.num_without_projection) == (0.4, 1)


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_median_is_that_of_numpy(count):
    errors = np.random.default_rng(count).random(count)
    assert summarize_clipped(errors).median == np.median(errors)


def test_without_projections_and_without_observations():
    found = summarize_clipped(np.array([np.nan, np.nan, 1.0]))
    assert (found.median, found.clipped_rmse) == (np.inf, pytest.approx(np.sqrt(33 / 3)))
    assert np.isnan(summarize_clipped(np.array([np.nan])).rmse)
    nothing = summarize_clipped(np.zeros(0))
    assert nothing.num_observations == 0
    assert np.isnan([nothing.rmse, nothing.median, nothing.clipped_rmse]).all()


def test_points_behind_their_camera_have_no_error():
    problem = make_problem(num_images=3, num_points=20)
    points = problem.points.copy()
    points[4] = problem.projection_centers[0] - 0.5
    errors = errors_or_nan(problem.replace(points=points))
    assert np.isnan(errors[problem.observation_point == 4]).any()
    assert np.isfinite(errors[problem.observation_point != 4]).all()
