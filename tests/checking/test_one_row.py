"""Mistakes within one row of a Jacobian have their own names."""

from __future__ import annotations

import numpy as np
import pytest

from tests.checking.reprojection import check_few

BLOCKS = [[1.3, 2.1], [0.2, -0.4]]


def bearing_and_range(change):
    """Range and bearing from the first block to the second, in three rows, with a mistake."""

    def function(blocks):
        x, y = blocks[0] - blocks[1]
        squared = x * x + y * y
        r = np.sqrt(squared)
        jacobian = np.array([[x / r, y / r], [-y / squared, x / squared], [y, x]])
        change(jacobian, x, y, r)
        return np.array([r, np.arctan2(y, x), x * y]), [jacobian, -jacobian]

    return function


def root_for_square(jacobian, _x, _y, r):
    jacobian[1] *= r  # 1 / r for 1 / r^2


def extra_range(jacobian, _x, _y, r):
    jacobian[0] *= r


def swapped(jacobian, x, y, r):
    jacobian[1] = np.array([-x, y]) / r**2


def swapped_range(jacobian, x, y, r):
    jacobian[0] = np.array([y, x]) / r


def swapped_negative(jacobian, x, y, r):
    jacobian[0] = np.array([-y, -x]) / r


def swapped_one_sign(jacobian, x, y, r):
    jacobian[0] = np.array([-y, x]) / r


def swapped_other_sign(jacobian, x, y, r):
    jacobian[0] = np.array([y, -x]) / r


def other_formula(jacobian, x, y, r):
    jacobian[1] = np.array([np.sin(x * y), np.cos(x + 2 * y)]) / r


@pytest.mark.parametrize(
    ("change", "kind", "row", "count"),
    [
        (root_for_square, "row_factor", 1, 1),
        (extra_range, "row_factor", 0, 1),
        (swapped, "row_swapped", 1, 2),
        (swapped_range, "row_swapped", 0, 2),
        (swapped_negative, "row_swapped", 0, 2),
        (swapped_one_sign, "row_swapped", 0, 2),
        (swapped_other_sign, "row_swapped", 0, 2),
        (other_formula, "one_row", 1, 1),
    ],
)
def test_a_mistake_in_one_row_has_its_name(change, kind, row, count):
    for seed in range(3):
        report = check_few(bearing_and_range(change), BLOCKS, seed=seed)
        assert {finding.kind for finding in report.findings} == {kind}
        assert len(report.findings) == count  # exchanged entries once per block
        assert {finding.rows for finding in report.findings} == {(row,)}
        names = [name for finding in report.findings for name in finding.columns]
        assert sorted(names) == ["block 0 [0]", "block 0 [1]", "block 1 [0]", "block 1 [1]"]
        for finding in report.findings:
            assert f"residual {row}" in finding.sentence
            if kind == "row_swapped":
                assert ("wrong sign" in finding.sentence) == (change is not swapped_range)


def test_exchanged_rows_are_no_mistake_of_one_row():
    def exchanged(jacobian, _x, _y, _r):
        jacobian[[0, 1]] = jacobian[[1, 0]]

    report = check_few(bearing_and_range(exchanged), BLOCKS)
    assert {finding.kind for finding in report.findings} == {"swapped_rows"}


def test_two_rows_are_no_mistake_of_one_row():
    def both(jacobian, x, y, r):
        root_for_square(jacobian, x, y, r)
        jacobian[2] += 0.3 * np.array([x, y])

    report = check_few(bearing_and_range(both), BLOCKS)
    assert not {"row_factor", "row_swapped", "one_row"} & {f.kind for f in report.findings}


def test_a_mistake_of_rank_one_in_several_rows_is_a_term_of_the_chain_rule():
    def term(jacobian, x, y, _r):
        jacobian += np.outer([0.2, 0.5 * x, y], [y, 0.3 * x])

    report = check_few(bearing_and_range(term), BLOCKS)
    assert {finding.kind for finding in report.findings} == {"missing_term"}
