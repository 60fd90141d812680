"""Rates from times: nonnegative least squares of the relative errors, compared with SciPy's."""

import numpy as np
import pytest
from scipy.optimize import nnls

from bundle.planning.inspection.machine_rates import fit_rates

UNITS = np.array([1, 1e-12, 1e3, 1e6, 1, 1])


def solves(seed):
    """Counts of 30 solves, of which none has the second feature, and rates of 0 among others."""
    rng = np.random.default_rng(seed)
    rows = rng.uniform(size=(30, 6))
    rows[:, 4] = rows[:, 0] + 0.2 * rows[:, 4]  # features that grow together
    rows[:, 1] = 0
    rates = np.array([1.0, 0, 0.3, 0, 0.5, 2])
    times = 10.0 ** rng.uniform(-3, 1, 30) * np.exp(0.1 * rng.normal(size=30))
    return rows * (times / (rows @ rates))[:, None], times


@pytest.mark.parametrize("seed", range(6))
def test_rates_are_the_nonnegative_least_squares(seed):
    rows, times = solves(seed)
    found = fit_rates(rows, times)
    expected, _ = nnls(rows / times[:, None], np.ones(30))
    assert (found >= 0).all() and found[1] == 0
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)


def test_rates_follow_the_units_of_counts_and_times():
    rows, times = solves(9)
    found = fit_rates(rows, times)
    np.testing.assert_allclose(fit_rates(rows / UNITS, times) / UNITS, found, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(fit_rates(rows, 1e-6 * times), 1e-6 * found, rtol=1e-6, atol=1e-18)


def test_exact_times_give_their_rates():
    rows = np.random.default_rng(3).uniform(size=(12, 4))
    rates = np.array([0.5, 0, 2, 1e-3])
    np.testing.assert_allclose(fit_rates(rows, rows @ rates), rates, atol=1e-8)
