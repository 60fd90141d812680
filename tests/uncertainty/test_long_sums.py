"""Covariances of small problems, whose points are eliminated from rows and summed up long."""

import pytest

from tests.campaigns.covariance import TOLERANCE, compare_seed


@pytest.mark.parametrize(
    ("seed", "robust"), [(69, "weights"), (169, "sandwich"), (198, "sandwich")]
)
def test_small_problems_lose_nothing_by_sums_of_squares(seed, robust):
    """These would: rounded as sums of squares, 1e-8 and more of a sigma."""
    entry = next(entry for entry in compare_seed(seed) if entry.robust == robust)
    assert entry.rounding > 5 * TOLERANCE
    assert entry.difference < 2e-9
