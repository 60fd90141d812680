"""Numbers whose squares overflow or vanish: verdicts as ever, and no warning of NumPy."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import bundle
from tests.checking.reprojection import check_few

SIZES = [1e307, 1e300, 1e200, 1e160, 1e-160, 1e-300]


def scaled_rows(size, factor):
    """A large or small row beside a usual one, at usual parameters."""

    def function(blocks):
        x, y = blocks[0]
        return np.array([size * x, x * y]), [np.array([[factor * size, 0], [y, x]])]

    return function, [np.array([1.0, 2.0])]


def scaled_parameters(size, factor):
    """Parameters of this size, in a residual of a usual one."""

    def function(blocks):
        return blocks[0] / size, [factor * np.eye(2) / size]

    return function, [np.array([1.0, 2.0]) * size]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("make", [scaled_rows, scaled_parameters])
def test_extreme_numbers_are_checked_without_warnings(make, size):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        verdicts = {
            factor: check_few(*make(size, factor)).verdict for factor in (1.0, -1.0, 2.0, 1.001)
        }
    assert verdicts.pop(1.0) != "wrong"
    if make is scaled_rows or size > 1:
        assert set(verdicts.values()) == {"wrong"}


@pytest.mark.parametrize(("factor", "kind"), [(-1.0, "sign"), (2.0, "factor")])
@pytest.mark.parametrize("make", [scaled_rows, scaled_parameters])
def test_mistakes_in_large_numbers_are_named(make, factor, kind):
    assert check_few(*make(1e300, factor)).kinds == {kind}


@pytest.mark.parametrize("parameter", [1e-20, 1e-100])
def test_a_pole_beside_a_tiny_parameter_is_no_mistake(parameter):
    """Only steps of its own size see the slope of 1 / x."""

    def function(blocks):
        return 1 / blocks[0], [np.diag(-1 / blocks[0] ** 2)]

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = bundle.check_gradients(function, [np.array([parameter])], num_samples=3)
    assert report.verdict != "wrong", report


@pytest.mark.parametrize("factor", [1e160, 1e200])
def test_a_huge_factor_is_named_as_one(factor):
    """Squares of the deviation overflow, which is no agreement with the first guess."""

    def function(blocks):
        (x, y) = blocks[0]
        return np.array([x * y, x + y]), [np.array([[y, x * factor], [1.0, factor]])]

    report = check_few(function, [np.array([1.5, -0.7])])
    assert [(f.kind, f.columns) for f in report.findings] == [("factor", ("block 0 [1]",))]


def test_a_jacobian_that_overflows_is_not_finite_and_not_stale():
    def function(blocks):
        with np.errstate(over="ignore"):
            return np.append(1e-300 * blocks[0], 1.0), [np.array([[np.float64(1e308) * 1e3], [0]])]

    assert check_few(function, [np.array([1.5])]).kinds == {"not_finite"}
