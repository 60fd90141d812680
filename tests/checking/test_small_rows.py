"""Rows of small numbers beside large ones: mistakes are found, right ones not accused."""

from __future__ import annotations

import numpy as np
import pytest

import bundle
from bundle.checking.jacobian_deviation import ALIKE, JacobianDeviation
from tests.checking.reprojection import check_few

SCALES = (1e-3, 1e-6, 1e-7, 1e-9, 1e-12)
START = [1.3, -0.7, 0.5, 2.0]


def plain(x):
    """Three rows of four numbers; the last column belongs to the last two rows only."""
    a, b, c, d = x
    growth = np.exp(0.1 * a)
    residual = np.array([a * b + np.sin(c), growth * d, c * d - a])
    jacobian = np.array([[b, a, np.cos(c), 0], [0.1 * growth * d, 0, 0, growth], [-1, 0, d, c]])
    return residual, jacobian


def check(change, start=START, **settings):
    """Check the residual after a change of (residual, Jacobian)."""

    def function(blocks):
        residual, jacobian = change(*plain(blocks[0]))
        return residual, [jacobian]

    return check_few(function, [start], **settings)


def in_units(row, scale, spoil=None):
    def change(residual, jacobian):
        units = np.ones(3)
        units[row] = scale
        jacobian = units[:, None] * jacobian
        if spoil is not None:
            spoil(jacobian)
        return units * residual, jacobian

    return change


def times(row, column, factor):
    def spoil(jacobian):
        jacobian[row, column] *= factor

    return spoil


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("row", [0, 1, 2])
def test_a_mistake_in_a_small_row_is_found(row, scale):
    assert check(in_units(row, scale)), "right in any units"
    for factor in (-1, 2, 0, 1.001):
        report = check(in_units(row, scale, times(row, 0, factor)))
        assert report.verdict == "wrong", factor
        (finding,) = report.findings
        assert finding.rows == (row,)
        assert finding.columns == ("block 0 [0]",)


@pytest.mark.parametrize("scale", SCALES)
def test_a_mistake_in_a_small_row_is_named(scale):
    assert check(in_units(1, scale, times(1, 0, -1))).kinds == {"sign"}
    assert check(in_units(1, scale, times(1, 3, 2))).kinds == {"factor"}
    assert check(in_units(2, scale, times(2, 2, 0))).kinds == {"zero"}

    def swap(jacobian):
        jacobian[[0, 1]] = jacobian[[1, 0]] * [[1 / scale], [scale]]

    assert check(in_units(1, scale, swap)).kinds == {"swapped_rows"}


def test_a_small_row_hides_less_than_a_thousandth_of_itself():
    """In a row of its own, 1e-7; beside larger ones ALIKE times that."""
    for off, verdict in ((20e-7 * ALIKE, "wrong"), (0.1e-7 * ALIKE, "correct")):
        report = check(in_units(1, 1e-9, times(1, 0, 1 + off)))
        assert report.verdict == verdict, off


def test_rows_that_are_all_small_need_no_unit():
    def change(residual, jacobian):
        return 1e-9 * residual, 1e-9 * jacobian * [[1], [1], [1 + 1e-6]]

    assert check(change).verdict == "wrong"


def test_a_column_of_the_small_row_alone_does_not_hide_the_others():
    """The second row has a parameter of its own."""

    def function(blocks):
        a, b, own = blocks[0]
        jacobian = np.array([[b, a, 0], [-1e-9 * b, 1e-9 * a, 1e-9 * np.cos(own)]])
        return [a * b, 1e-9 * (a * b + np.sin(own))], [jacobian]

    assert check_few(function, [[1.0, 2.0, 0.3]]).verdict == "wrong"


def test_a_robust_loss_that_is_flat_here_is_right():
    """Tukey's, outside: at the largest steps, residuals change again."""

    def function(blocks):
        (x,) = blocks[0]
        inside = x < 3.2
        return [(3.2 - x) ** 2 if inside else 0.0], [np.array([[-2 * (3.2 - x) * inside]])]

    assert bundle.check_gradients(function, [[3.3]], num_samples=1)


def hashed(x):
    bits = np.ascontiguousarray(x).view(np.uint64)
    return np.random.default_rng(int(np.bitwise_xor.reduce(bits))).standard_normal()


def row_of(value, entries=(0, 0, 0, 0)):
    def change(residual, jacobian):
        residual[1], jacobian[1] = value, entries
        return residual, jacobian

    return change


def test_rows_of_zeros_and_of_constants_are_right():
    for value in (0.0, 1e-12, 7.0, 1e3):
        assert check(row_of(value)), value
    tiny = 0.1 + 0.2 - 0.3  # what is left of a sum
    assert check(row_of(0.0, [tiny, 0, -tiny, 0])), "rounding of the Jacobian alone"
    assert check(row_of(0.0, [1e-3, 0, 0, 0])).verdict == "wrong"


@pytest.mark.parametrize("size", [1e-15, 1e-12, 1e-9, 1e-6])
def test_rows_of_noise_are_not_accused(size):
    def function(blocks):
        residual, jacobian = plain(blocks[0])
        residual[1], jacobian[1] = size * hashed(blocks[0]), 0
        return residual, [jacobian]

    assert check_few(function, [START]).verdict != "wrong"


@pytest.mark.parametrize("constant", [1.0, 1e3, 1e6])
@pytest.mark.parametrize("scale", SCALES)
def test_small_rows_that_lose_digits_in_constants_are_not_accused(scale, constant):
    for subtract in (0.0, constant):

        def change(residual, jacobian, subtract=subtract):
            residual, jacobian = in_units(0, scale)(residual, jacobian)
            residual[0] = (residual[0] + constant) - subtract
            return residual, jacobian

        assert check(change).verdict != "wrong"


def test_a_slope_below_the_last_digit_of_its_row_is_no_mistake():
    """By x the row changes in jumps of 1e-9, by y its slope is too small for one."""

    def function(blocks):
        x, y = blocks[0]
        small = 1e-8 * x + 1e-10 * y
        return [x * y, np.round(small, 9)], [np.array([[y, x], [1e-8, 1e-10]])]

    assert check_few(function, [[3.0, 0.5]]).verdict != "wrong"


def test_single_precision_of_a_small_row_is_not_accused():
    def change(residual, jacobian):
        residual, jacobian = in_units(2, 1e-6)(residual, jacobian)
        return np.float32(residual).astype(float), jacobian

    assert check(change).verdict != "wrong"


def deviation(reference, uncertainty=0.0, tolerance=1e-7):
    reference = np.array(reference, float)[None]
    return JacobianDeviation(
        reference, reference, np.broadcast_to(uncertainty, reference.shape), tolerance
    )


def test_units_are_recovered_through_a_chain_of_rows():
    """No two of the outer rows share a column."""
    units, columns = [1.0, 1e-7, 1e-14], np.array([3.0, 1e-5, 1e4, 2.0])
    pattern = np.array([[1, 1, 0, 0], [0, 1, 1, 0], [0, 0, 1, 1]])
    found = deviation(np.array(units)[:, None] * columns * pattern).scale[0]
    assert found[0, 1] == pytest.approx(1e-5, rel=1e-3), "the largest row: by the column"
    assert np.log10(found[1, 1] / (1e-5 * 1e-7 * ALIKE)) == pytest.approx(0, abs=0.5)
    assert np.log10(found[2, 2] / (1e4 * 1e-14)) == pytest.approx(0, abs=0.5), "no large row"


def test_rows_that_are_alike_share_a_unit():
    alike = deviation([[1.0, 2.0], [1.01 / ALIKE, 2.02 / ALIKE]]).scale[0]
    assert alike.tolist() == [alike[0].tolist()] * 2
    other = deviation([[1.0, 2.0], [0.1 / ALIKE, 0.2 / ALIKE]]).scale[0]
    assert other[1] == pytest.approx(0.1 * other[0], rel=0.2)


def test_no_entry_is_judged_more_exactly_than_its_reference():
    rows = [[1.0, 1.0], [1e-9, 1e-9]]
    doubtful = deviation(rows, [[0, 0], [1e-11, 0]]).scale[0]
    assert doubtful[1, 0] == pytest.approx(1e-11 / 1e-7)
    lenient = deviation(rows, [[0, 0], [1e-11, 0]], 1e-4).scale[0]
    assert lenient[1, 0] == pytest.approx(1e-6, rel=0.1), "1000 times the row"
    assert deviation(rows, [[0, 0], [1.0, 0]]).scale[0][1, 0] == pytest.approx(1.0), "by the column"


def test_rows_without_a_known_entry_have_no_unit_of_their_own():
    rows = [[1.0, 1.0], [1e-9, 1e-9]]
    assert deviation(rows, [[0, 0], [1e-9, 1e-9]]).scale[0] == pytest.approx(1.0)


def test_a_row_that_vanishes_at_one_point_keeps_its_usual_unit():
    usual = np.array([[1.0, 1.0], [1e-6, 1e-6]])
    there = usual * [[1.0], [1e-9]]
    points = np.array([usual, usual, there])
    found = JacobianDeviation(points, points, np.zeros_like(points)).scale
    assert found[2, 1] == pytest.approx(1e-3 * found[0, 1], rel=1e-2)
