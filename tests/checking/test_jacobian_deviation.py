"""Units of rows and divisors of columns: which mistakes are found, and which noise is not."""

import numpy as np
import pytest

from bundle.checking.jacobian_deviation import JacobianDeviation
from bundle.interface.analysis_options import TOLERANCE

SMALL_ROW = 1e-9


def deviation(reference, *, error=0.0, uncertainty=0.0):
    shape = np.shape(reference)
    reference = np.array(reference, float)[None]
    return JacobianDeviation(
        reference + np.broadcast_to(error, shape),
        reference,
        np.broadcast_to(np.asarray(uncertainty, float), reference.shape),
    )


@pytest.mark.parametrize(("share", "is_wrong"), [(2e-5, False), (2e-4, True)])
def test_a_mistake_above_a_ten_thousandth_of_a_small_row_is_found(share, is_wrong):
    rows = np.array([[1.0, -2.0], [3e-9, 1e-9]])
    error = np.zeros((2, 2))
    error[1, 0] = share * 3e-9
    found = deviation(rows, error=error)
    assert (found.error[0, 1, 0] > TOLERANCE) == is_wrong


@pytest.mark.parametrize(("ratio", "is_alike"), [(1 / 500, True), (1 / 2000, False)])
def test_rows_within_a_thousand_share_a_unit(ratio, is_alike):
    found = deviation(np.array([[1.0, 1.0], [ratio, ratio]]), uncertainty=1e-30)
    assert (found.scale[0, 1, 0] == pytest.approx(found.scale[0, 0, 0])) == is_alike


@pytest.mark.parametrize(("times", "is_noise"), [(4, True), (16, False)])
def test_a_row_of_entries_near_their_uncertainty_has_the_unit_of_the_others(times, is_noise):
    uncertainty = np.array([[1e-20, 1e-20], [SMALL_ROW, SMALL_ROW]])
    rows = np.array([[1.0, 1.0], [times * SMALL_ROW, times * SMALL_ROW]])
    found = deviation(rows, uncertainty=uncertainty)
    assert (found.doubt[0, 1, 0] == pytest.approx(SMALL_ROW, rel=1e-6)) == is_noise


def test_a_column_that_vanishes_at_a_point_has_a_thousandth_of_its_usual_size():
    reference = np.ones((5, 1, 2))
    reference[2, 0, 1] = 0.0
    found = JacobianDeviation(reference, reference, np.zeros_like(reference))
    np.testing.assert_allclose(found.scale[2, 0], [1.0, 1e-3])
    np.testing.assert_allclose(found.scale[[0, 1, 3, 4]], 1.0)


def test_a_row_that_vanishes_at_a_point_has_a_thousandth_of_its_usual_unit():
    reference = np.ones((5, 2, 1))
    reference[2, 1, 0] = 1e-12
    found = JacobianDeviation(reference, reference, np.full_like(reference, 1e-30))
    np.testing.assert_allclose(found.scale[2, 1], 1e-3)


def test_units_of_rows_are_found_along_a_chain_of_entries():
    """Each row shares a column with the next alone: the fit needs tens of sweeps."""
    rows = np.logspace(0, -10, 4)
    found = deviation(rows[:, None] * (np.eye(4, 5) + np.eye(4, 5, 1)), uncertainty=1e-40)
    of_small_rows = np.diag(found.scale[0])[2:]
    assert (of_small_rows < 3 * rows[2:]).all(), "not by the larger row above"
