"""Performance profiles against numbers worked out by hand."""

import math

import pytest

from bundle.planning.comparison.comparison_result import performance_profiles
from tests.planning.comparison.fakes import DENSE, ITERATIVE, SPARSE

TIMES = [
    {DENSE: 1.0, SPARSE: 2.0, ITERATIVE: 4.0},
    {DENSE: 3.0, SPARSE: 2.0, ITERATIVE: math.nan},
    {DENSE: 6.0, SPARSE: math.nan, ITERATIVE: 6.0},
    {DENSE: 8.0, SPARSE: 1.0},
    {DENSE: math.nan, SPARSE: math.nan},
]


def test_shares():
    dense, sparse, iterative = performance_profiles(TIMES, [DENSE, SPARSE, ITERATIVE], 1e-3)
    assert dense.ratios == (1.0, 1.0, 1.5, 8.0)
    assert sparse.ratios == (1.0, 1.0, 2.0)
    assert iterative.ratios == (1.0, 4.0)
    assert dense.num_problems == sparse.num_problems == 4  # nobody solved the fifth
    assert [dense.share(tau) for tau in (0.99, 1, 1.5, 7.9, 8, math.inf)] == [
        0, 0.5, 0.75, 0.75, 1, 1,
    ]  # fmt: skip
    assert [sparse.share(tau) for tau in (1, 2, math.inf)] == [0.5, 0.75, 0.75]
    assert dense.gap == 1e-3


def test_a_clock_that_did_not_move():
    dense, sparse = performance_profiles([{DENSE: 0.0, SPARSE: 1e-3}], [DENSE, SPARSE], 1e-2)
    assert dense.share(1) == 1
    assert sparse.share(1e9) == 0


def test_nothing_solved():
    (profile,) = performance_profiles([{DENSE: math.nan}], [DENSE], 1e-2)
    assert profile.share(math.inf) == 0
    assert profile.num_problems == 0


@pytest.mark.parametrize("factor", [2, 1000])
def test_units_do_not_matter(factor):
    scaled = [{method: factor * time for method, time in row.items()} for row in TIMES]
    assert performance_profiles(scaled, [DENSE, SPARSE], 1) == performance_profiles(
        TIMES, [DENSE, SPARSE], 1
    )
