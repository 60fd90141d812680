"""Patterns as images: every nonzero counted once, on the pixels that it covers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import bundle
from bundle.figures.matplotlib.matrix_pattern import (
    FAINTEST,
    MatrixPattern,
    factor_columns,
    factor_density,
    matrix_density,
)


def random_pattern(seed: int, num_blocks: int, sizes: tuple[int, int] = (1, 1)) -> MatrixPattern:
    generator = np.random.default_rng(seed)
    edges = generator.integers(0, num_blocks, (2 * num_blocks, 2))
    drawn = generator.integers(sizes[0], sizes[1] + 1, num_blocks)
    return MatrixPattern.from_edges(num_blocks, edges, [int(size) for size in drawn])


def dense(pattern: MatrixPattern) -> NDArray[np.bool_]:
    """Return the scalar pattern, both triangles."""
    begin = np.concatenate([[0], np.cumsum(pattern.sizes)])
    matrix = np.zeros((begin[-1], begin[-1]), bool)
    for row, column in zip(pattern.rows, pattern.columns, strict=True):
        matrix[begin[row] : begin[row + 1], begin[column] : begin[column + 1]] = True
    return matrix | matrix.T


def eliminated(matrix: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the lower triangle of a symmetric pattern after elimination, by the definition."""
    full = matrix.copy()
    for pivot in range(len(full)):
        below = pivot + 1 + np.flatnonzero(full[pivot + 1 :, pivot])
        full[np.ix_(below, below)] = True
    return np.tril(full)


def pooled(matrix: NDArray[np.bool_], pixels: int) -> NDArray[np.float64]:
    """Return sums over pixels, cells split by the area that each pixel has of them."""
    borders = np.linspace(0, len(matrix), pixels + 1)
    cells = np.arange(len(matrix))
    high = np.minimum(borders[1:, None], cells + 1)
    share = np.clip(high - np.maximum(borders[:-1, None], cells), 0, None)
    return share @ matrix @ share.T


PATTERNS = [
    random_pattern(1, 30),
    random_pattern(2, 12, (6, 6)),
    random_pattern(3, 17, (1, 9)),
    MatrixPattern.from_edges(1, []),
]


@pytest.mark.parametrize("pixels", [5, 13, 64, 400])
@pytest.mark.parametrize("pattern", PATTERNS, ids=["scalars", "blocks", "mixed", "one"])
def test_images_are_sums_over_pixels(pattern: MatrixPattern, pixels: int) -> None:
    order = np.random.default_rng(4).permutation(pattern.num_blocks)
    matrix = dense(pattern.permuted(order))
    image = matrix_density(pattern, order, pixels)
    pixels = min(pixels, len(matrix))
    np.testing.assert_allclose(image.entries, pooled(matrix, pixels), atol=1e-9)
    assert image.num_nonzeros == pattern.num_nonzeros == matrix.sum()
    factor = factor_density(pattern, order, pixels)
    lower = eliminated(matrix)
    np.testing.assert_allclose(factor.entries + factor.fill, pooled(lower, pixels), atol=1e-5)
    np.testing.assert_allclose(factor.fill, pooled(lower & ~np.tril(matrix), pixels), atol=1e-5)
    assert factor.num_nonzeros == lower.sum()


@pytest.mark.parametrize("seed", range(10))
def test_columns_of_the_factor_are_those_of_elimination(seed: int) -> None:
    pattern = random_pattern(seed, 40)
    lower = eliminated(dense(pattern))
    for column, rows in enumerate(factor_columns(pattern)):
        np.testing.assert_array_equal(rows, np.flatnonzero(lower[:, column]))


def test_a_permuted_pattern_has_its_rows_and_columns_permuted() -> None:
    pattern = random_pattern(5, 20)
    order = np.random.default_rng(6).permutation(20)
    np.testing.assert_array_equal(
        dense(pattern.permuted(order)), dense(pattern)[np.ix_(order, order)]
    )


def test_one_nonzero_among_thousands_stays_visible_and_tenths_are_told_apart() -> None:
    size, pixels = 30_000, 400
    diagonal_only = matrix_density(MatrixPattern.from_edges(size, []), pixels=pixels)
    assert diagonal_only.tone().diagonal().min() > FAINTEST
    lone = matrix_density(MatrixPattern.from_edges(size, [(29_990, 10)]), pixels=pixels)
    assert lone.tone()[-1, 0] >= FAINTEST - 1e-9
    full = matrix_density(MatrixPattern.from_edges(60, np.argwhere(np.ones((60, 60)))), pixels=20)
    assert full.tone().min() == 1.0
    rest = np.argwhere(np.random.default_rng(7).random((60, 60)) < 0.1)
    tenth = matrix_density(MatrixPattern.from_edges(60, rest), pixels=4)
    assert 0.5 < np.median(tenth.tone()) < 0.95


def test_fill_is_orange_and_entries_are_black() -> None:
    star = MatrixPattern.from_edges(7, [(0, leaf) for leaf in range(1, 7)])
    image = factor_density(star).rgba()
    assert tuple(image[6, 1]) == (217, 72, 15, 255)
    assert tuple(image[6, 0]) == (0, 0, 0, 255)
    assert image[1, 6, 3] == 0
    leaves_first = factor_density(star, [1, 2, 3, 4, 5, 6, 0])
    assert not leaves_first.fill.any()


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        (([1, 1], [0, 1], [0]), "column_begin: expected 3 numbers"),
        (([1, 1], [0, 1, 3], [0, 1, 2]), "rows: expected the lower triangle"),
        (([1, 1], [0, 1, 3], [0, 0, 1]), "rows: expected the lower triangle"),
    ],
)
def test_a_pattern_that_is_none_is_refused(arrays: tuple[list[int], ...], words: str) -> None:
    with pytest.raises(bundle.InputError, match=words):
        MatrixPattern(*(np.array(array) for array in arrays))


def test_an_order_that_is_none_is_refused() -> None:
    with pytest.raises(bundle.InputError, match="order: expected each of 3 blocks once"):
        matrix_density(MatrixPattern.from_edges(3, []), [0, 1, 1])
