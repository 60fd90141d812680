"""Counts of J, J^T J, S and L, against hand-made numbers and elimination by its definition."""

from __future__ import annotations

import numpy as np
import pytest

from bundle import _core
from bundle.interface.options import SolveOptions
from bundle.planning.inspection.problem_pattern import count_dense, count_factor, find_pattern
from bundle.planning.inspection.problem_time import make_scene
from bundle.solving.layout import resolve_defaults
from tests.planning.inspection.dense_oracle import (
    eliminate_first,
    factor_pattern,
    jacobian_pattern,
    scalar_order,
    visible,
)

POSES = ("poses", "points")


def pattern_of(problem, **options):
    return find_pattern(problem, resolve_defaults(problem, SolveOptions(gauge="none", **options)))


def sparse_scene(seed, *, shared_camera=False):
    """Nine images, some points seen by few of them, some images by no other."""
    problem = make_scene(9, 25, 9, shared_camera=shared_camera)
    rng = np.random.default_rng(seed)
    seen = [(int(i), p) for p in range(25) for i in rng.choice(9, rng.integers(1, 4), False)]
    return visible(problem, seen)


def test_three_cameras_and_four_points():
    tracks = [(0, 1), (0, 1, 2), (1, 2), (0, 2)]
    seen = [(image, point) for point, images in enumerate(tracks) for image in images]
    pattern = pattern_of(visible(make_scene(3, 4, 3), seen), refine=POSES)
    assert pattern.num_unknowns == 3 * 6 + 4 * 3
    assert pattern.reduced.nnz == 18 * 18
    assert pattern.nnz_jacobian == 9 * 2 * (6 + 3)
    assert pattern.nnz_information == 3 * 36 + 4 * 9 + 2 * 9 * 18
    # 4 + 9 + 4 + 4 = 21 products of both triangles; each pair once and the diagonal: 15.
    assert pattern.block_pairs == 15
    assert pattern.pair_entries == (12**2 + 18**2 + 12**2 + 12**2) / 2
    assert pattern.plan.num_pairs == 6
    assert pattern.num_observations == 9


def test_a_hundred_cameras():
    pattern = pattern_of(make_scene(100, 20_000, 4, scattered=True), refine=POSES)
    assert pattern.num_unknowns == 60_600
    assert pattern.block_pairs == 20_000 * 10
    assert pattern.reduced.nnz == 600**2
    assert count_dense(60_600, 0, 1).flops == pytest.approx(7.4e13, rel=0.01)
    assert count_dense(600, 0, 1).flops == pytest.approx(7.2e7, rel=0.015)


@pytest.mark.parametrize("shared_camera", [False, True])
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"refine": POSES},
        {"fixed_image_ids": (2, 3), "fixed_point_ids": (0, 5, 6)},
        {"refine": ("points", "focal"), "fixed_point_ids": tuple(range(20))},
    ],
    ids=["all", "poses", "fixed", "focal"],
)
def test_against_full_matrices(shared_camera, options):
    problem = sparse_scene(3, shared_camera=shared_camera)
    given = resolve_defaults(problem, SolveOptions(gauge="none", **options))
    pattern = find_pattern(problem, given)
    blocks = _core.parameter_blocks(problem, given.asdict())
    sizes, is_free = blocks["size"], blocks["point_is_free"]
    jacobian = jacobian_pattern(
        problem, sizes, blocks["image_block"], blocks["camera_block"], is_free
    )
    information = jacobian.T @ jacobian
    reduced = eliminate_first(information, 3 * is_free.sum())
    assert pattern.nnz_jacobian == jacobian.sum()
    assert pattern.nnz_information == information.sum()
    assert pattern.reduced.nnz == reduced.sum()
    assert pattern.num_unknowns == jacobian.shape[1]
    assert pattern.num_observations == np.count_nonzero(jacobian.any(1)) / 2
    assert pattern.num_reduced_values == np.tril(reduced).sum() + (sizes * (sizes - 1) // 2).sum()
    for ordering in ("natural", "amd", "colamd", "metis", "nesdis", "minimum_fill"):
        order = _core.order_blocks(*pattern.reduced, ordering)
        factor = factor_pattern(reduced, scalar_order(order, sizes))
        below = factor.sum(0) - 1
        count = count_factor(pattern.reduced, order)
        assert count.nnz == factor.sum()
        assert count.flops == (below**2 + 3 * below).sum()
        assert count.cholmod_flops == ((below + 1) ** 2).sum()
        assert count.profile == tuple(below)
        assert _core.panel_values(*pattern.reduced, order) >= count.nnz


def test_profile_keeps_the_fullest_column_of_each_portion():
    pattern = pattern_of(make_scene(60, 400, 5)).reduced
    order = _core.order_blocks(*pattern, "amd")
    count = count_factor(pattern, order)
    blocks = _core.count_factor(*pattern, order)["rows_below"]
    columns = np.concatenate([below + np.arange(8, -1, -1) for below in blocks])
    first = np.arange(200) * len(columns) // 200
    assert count.profile == tuple(np.maximum.reduceat(columns, first))


@pytest.mark.parametrize("columns", [1, 2, 100, 450])
def test_dense(columns):
    below = np.arange(columns - 1, -1, -1)
    count = count_dense(columns, 7, 3)
    assert count.nnz == (below + 1).sum()
    assert count.flops == (below**2 + 3 * below).sum()
    assert count.cholmod_flops == ((below + 1) ** 2).sum()
    assert (count.fill, count.tree_height) == (7, 3)
    bins = min(columns, 200)
    first = np.arange(bins) * columns // bins
    assert count.profile == tuple(np.maximum.reduceat(below, first))


def test_dense_column_counts_squared():
    assert count_dense(100, 0, 1).flops - 3 * 4950 == 328_350
