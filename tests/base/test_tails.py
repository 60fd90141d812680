"""Tails of F and chi squared against SciPy's."""

import math

import pytest
from scipy import stats

from bundle.base.tails import chi2_tail, f_tail, student_quantile

VALUES = (1e-3, 0.2, 1.0, 4.0, 11.0, 60.0)


@pytest.mark.parametrize("freedom", [1, 2, 3, 6, 9])
def test_chi_squared(freedom):
    for value in VALUES:
        tail = stats.chi2.sf(value, freedom)
        assert chi2_tail(value, freedom) == pytest.approx(tail, rel=1e-12)
        assert f_tail(value / freedom, freedom, math.inf) == pytest.approx(tail, rel=1e-12)


@pytest.mark.parametrize("freedom", [1, 1.5, 2.3, 7, 40, 900, 2e5])
@pytest.mark.parametrize("numerator", [1, 2, 3, 6])
def test_f(numerator, freedom):
    for value in VALUES:
        tail = stats.f.sf(value, numerator, freedom)
        assert f_tail(value, numerator, freedom) == pytest.approx(tail, rel=1e-8)


def test_ends():
    assert f_tail(0.0, 3, 10) == f_tail(5.0, 3, 0.9) == chi2_tail(0, 2) == 1
    assert f_tail(2.0, 3, 1e6) == pytest.approx(f_tail(2.0, 3, 1.1e6), rel=1e-5)


@pytest.mark.parametrize("z", [0.0, 0.5, 2.0, 3.2905])
@pytest.mark.parametrize("freedom", [1, 2, 4, 19, 1000])
def test_quantiles_of_student_have_the_probability_of_normal_ones(z, freedom):
    expected = stats.t.isf(stats.norm.sf(z), freedom)
    assert student_quantile(z, freedom) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert student_quantile(z, 0) == z
