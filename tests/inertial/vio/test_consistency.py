"""A window gains nothing on what it cannot see: the heading, from a compass' start."""

import numpy as np
import pytest

from tests.campaigns.window_consistency import YAW_SIGMA, fly, follow, headings


@pytest.mark.parametrize("kind", ["first_estimate", "current", "relinearize_prior"])
def test_only_first_estimates_leave_the_heading_as_uncertain_as_it_was(kind):
    rows = follow(fly(1, seconds=12), kind, seed=1, yaw=np.radians(YAW_SIGMA))
    sigmas = rows[:, 2] / np.radians(YAW_SIGMA)
    if kind == "first_estimate":
        assert (sigmas > 0.9999).all()
        assert sigmas[-1] < 1.05  # what the gyroscope adds
    else:
        assert sigmas[-1] < 0.9


def test_headings_have_the_mean_square_of_their_sigma():
    errors = np.degrees(headings(50))
    assert np.mean(errors**2) == pytest.approx(YAW_SIGMA**2)
    assert np.mean(errors) == pytest.approx(0, abs=1e-12)
