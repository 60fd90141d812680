"""Factor counts of each method, and the bound where counting would take too long."""

from __future__ import annotations

import numpy as np
import pytest

from bundle import _core
from bundle.interface.options import SolveOptions
from bundle.planning.inspection import peak_memory
from bundle.planning.inspection.peak_memory import FactorCounter
from bundle.planning.inspection.problem_pattern import find_pattern
from bundle.solving.layout import resolve_defaults
from tests.planning.inspection.dense_oracle import (
    drive,
    factor_pattern,
    jacobian_pattern,
    scalar_order,
)


def counter_of(problem, **options):
    given = resolve_defaults(problem, SolveOptions(gauge="none", **options))
    return FactorCounter(problem, given, find_pattern(problem, given))


@pytest.fixture
def small():
    return drive(6, 20, 3)


def information(problem):
    blocks = _core.parameter_blocks(
        problem, resolve_defaults(problem, SolveOptions(gauge="none")).asdict()
    )
    jacobian = jacobian_pattern(
        problem,
        blocks["size"],
        blocks["image_block"],
        blocks["camera_block"],
        blocks["point_is_free"],
    )
    return jacobian.T @ jacobian


def test_dense_counts_the_pairs_that_do_not_meet(small):
    counted = counter_of(small).dense()
    assert counted.columns == 54
    assert counted.factor.nnz == 54 * 55 // 2
    # Images more than two apart have no common point: 3 + 2 + 1 pairs.
    assert counted.factor.fill == 6
    assert counted.nnz_reduced == 81 * (36 - 2 * 6)


def test_whole_problem(small):
    counted = counter_of(small).whole()
    matrix = information(small)
    full = _core.full_pattern(small, resolve_defaults(small, SolveOptions(gauge="none")).asdict())
    order = _core.order_blocks(*full, "amd")
    factor = factor_pattern(matrix, scalar_order(order, full[0]))
    assert (counted.columns, counted.nnz_reduced, counted.note) == (114, 0, "")
    assert counted.factor.nnz == factor.sum()


def test_whole_problem_too_large_for_its_own_order(small, monkeypatch):
    exact = counter_of(small).whole()
    monkeypatch.setattr(peak_memory, "MOST_ENTRIES_FOR_AMD", 10)
    counted = counter_of(small).whole()
    assert "points first" in counted.note
    assert counted.factor.nnz == pytest.approx(exact.factor.nnz, rel=0.05)


def test_cameras_first(small):
    counted = counter_of(small).cameras_first()
    matrix = information(small)
    cameras = np.arange(60, 114)
    left = matrix.copy()
    for k in cameras:
        met = np.flatnonzero(left[:, k])
        left[np.ix_(met, met)] = True
    points = left[:60, :60]
    assert counted.columns == 60
    assert counted.nnz_reduced == points.sum()
    assert counted.note == ""
    assert counted.factor.nnz >= np.tril(points).sum()


def test_cameras_first_is_bounded_where_it_is_too_much(small, monkeypatch):
    exact = counter_of(small).cameras_first()
    monkeypatch.setattr(peak_memory, "MOST_POINT_PAIRS", 10)
    bound = counter_of(small).cameras_first()
    assert "upper bound" in bound.note
    assert bound.factor.nnz == 60 * 61 // 2 >= exact.factor.nnz
    assert bound.nnz_reduced >= exact.nnz_reduced
    assert bound.factor.flops >= exact.factor.flops
    assert bound.values >= exact.values / 1.2


def test_cameras_first_of_fixed_points(small):
    counted = counter_of(small, fixed_point_ids=tuple(range(15))).cameras_first()
    assert counted.columns == 15
