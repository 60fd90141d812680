"""Patterns of any size as small images: number of nonzeros per pixel.

If a matrix with 30,000 rows is drawn 400 pixels wide, a pixel covers 75 x 75 cells. Drawing each
nonzero as a dot would make the pixel black for one nonzero as well as for all 5,625. Therefore
nonzeros are counted per pixel; a block over several pixels counts by the share of each pixel. The
grey level is logarithmic in the count: a single nonzero stays visible, and a full pixel differs
from one that is 10 % full.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.records import dataclass
from bundle.figures.matplotlib.matrix_pattern import MatrixPattern, factor_columns

# Darkness of a pixel with a single nonzero among many cells; a full pixel has 1.
FAINTEST = 0.28
FILL_COLOUR = (217, 72, 15)
# Counts are sums of fractions; smaller counts are treated as zero.
ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class Density:
    """Nonzeros per pixel of a square matrix.

    Attributes:
        entries: (pixels, pixels) nonzeros of the matrix on each pixel; fractional if a block
            covers several pixels.
        fill: (pixels, pixels) fill-in: nonzeros of the factor that are zero in the matrix.
        num_unknowns: scalar rows of the matrix.
    """

    entries: NDArray[np.float64]
    fill: NDArray[np.float64]
    num_unknowns: int

    @property
    def num_nonzeros(self) -> int:
        """Number of nonzeros: both triangles and the diagonal of a matrix, or all of L."""
        return round(float(self.entries.sum() + self.fill.sum()))

    def tone(self) -> NDArray[np.float64]:
        """Return the darkness of each pixel from 0 (all zeros) to 1 (all nonzeros)."""
        count = self.entries + self.fill
        cells = (self.num_unknowns / max(len(count), 1)) ** 2
        if cells <= 1.0:
            return np.clip(count / max(cells, 1e-300), 0.0, 1.0)
        grown = FAINTEST + (1.0 - FAINTEST) * np.log(np.maximum(count, 1.0)) / np.log(cells)
        return np.clip(np.where(count < 1.0, FAINTEST * count, grown), 0.0, 1.0)

    def rgba(self) -> NDArray[np.uint8]:
        """Return (pixels, pixels, 4): black, or orange for fill-in, with the tone as alpha."""
        total = self.entries + self.fill
        share = np.divide(self.fill, total, out=np.zeros_like(total), where=total > 0)
        image = np.empty((*total.shape, 4), np.uint8)
        image[..., :3] = np.rint(share[..., None] * np.array(FILL_COLOUR)).astype(np.uint8)
        image[..., 3] = np.rint(255.0 * self.tone()).astype(np.uint8)
        return image


def matrix_density(
    pattern: MatrixPattern, order: ArrayLike | None = None, pixels: int = 400
) -> Density:
    """Return the density of a symmetric matrix, both triangles, with blocks in the given order."""
    grid = _Grid(pattern.permuted(order), pixels)
    lower = grid.lower_triangle()
    entries = np.maximum(lower + lower.T - grid.diagonal_blocks(), 0.0)
    return Density(entries, np.zeros_like(entries), grid.num_unknowns)


def factor_density(
    pattern: MatrixPattern, order: ArrayLike | None = None, pixels: int = 400
) -> Density:
    """Return the density of the Cholesky factor of a matrix with blocks in the given order.

    Diagonal blocks count with their lower triangle. Time grows with the nonzero blocks of L.
    """
    ordered = pattern.permuted(order)
    grid = _Grid(ordered, pixels)
    lower = grid.lower_triangle()
    fill = np.maximum(grid.columns(factor_columns(ordered)) - lower, 0.0)
    return Density(
        np.maximum(lower - grid.above_diagonal(), 0.0),
        np.where(fill > ROUNDING, fill, 0.0),
        grid.num_unknowns,
    )


class _Grid:
    """Grid of pixels over a lower triangle of blocks; it counts the cells of blocks per pixel."""

    def __init__(self, pattern: MatrixPattern, pixels: int) -> None:
        self.pattern = pattern
        self.num_unknowns = pattern.num_unknowns
        self.pixels = min(pixels, self.num_unknowns)
        self.width = self.num_unknowns / max(self.pixels, 1)
        self.begin = np.concatenate([[0], np.cumsum(pattern.sizes)])
        self.borders = np.linspace(0.0, self.num_unknowns, self.pixels + 1)

    def lower_triangle(self) -> NDArray[np.float64]:
        """Return the number of cells of all blocks per pixel, with full diagonal blocks."""
        return self._blocks(self.pattern.rows, self.pattern.column_begin)

    def diagonal_blocks(self) -> NDArray[np.float64]:
        """Return the number of cells of the diagonal blocks per pixel."""
        return self._blocks(
            np.arange(self.pattern.num_blocks), np.arange(self.pattern.num_blocks + 1)
        )

    def above_diagonal(self) -> NDArray[np.float64]:
        """Return the number of cells per pixel above the diagonal, within diagonal blocks."""
        rows, columns = [], []
        for size in np.unique(self.pattern.sizes):
            row, column = np.triu_indices(size, 1)
            first = self.begin[:-1][self.pattern.sizes == size][:, None]
            rows.append((first + row).ravel())
            columns.append((first + column).ravel())
        if not rows:
            return np.zeros((0, 0))
        return self._scatter(
            self._halves(np.concatenate(rows), 1), self._halves(np.concatenate(columns), 1)
        )

    def columns(self, columns: Iterable[NDArray[Any]]) -> NDArray[np.float64]:
        """Return the number of cells per pixel of block columns, given by their block rows."""
        image = np.zeros((self.pixels, self.pixels))
        for column, rows in enumerate(columns):
            across = self._covered(np.array([column]))
            hit = np.flatnonzero(across)
            image[:, hit[0] : hit[-1] + 1] += np.outer(
                self._covered(rows), across[hit[0] : hit[-1] + 1]
            )
        return image

    def _covered(self, blocks: NDArray[Any]) -> NDArray[np.float64]:
        """Return the number of unknowns of ascending blocks on each pixel."""
        ends = np.stack([self.begin[blocks], self.begin[blocks + 1]], axis=1).ravel()
        sizes = np.zeros(len(ends))
        sizes[1::2] = self.pattern.sizes[blocks]
        return np.diff(np.interp(self.borders, ends, np.cumsum(sizes)))

    def _blocks(self, rows: NDArray[Any], begin: NDArray[Any]) -> NDArray[np.float64]:
        """Return the cells of blocks by columns, vectorised if no block is wider than a pixel."""
        sizes = self.pattern.sizes
        if len(sizes) == 0 or sizes.max() > self.width:
            return self.columns(rows[begin[j] : begin[j + 1]] for j in range(len(sizes)))
        columns = np.repeat(np.arange(len(sizes)), np.diff(begin))
        return self._scatter(
            self._halves(self.begin[rows], sizes[rows]),
            self._halves(self.begin[columns], sizes[columns]),
        )

    def _halves(self, first: NDArray[Any], size: Any) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        """Return (pixel, unknowns on it) of intervals, for their first pixel and the next one."""
        pixel = np.minimum((first / self.width).astype(np.int64), self.pixels - 1)
        here = np.minimum(size, (pixel + 1) * self.width - first)
        return [(pixel, here), (np.minimum(pixel + 1, self.pixels - 1), size - here)]

    def _scatter(self, rows: list[Any], columns: list[Any]) -> NDArray[np.float64]:
        image = np.zeros(self.pixels**2)
        for row, height in rows:
            for column, width in columns:
                image += np.bincount(row * self.pixels + column, height * width, self.pixels**2)
        return image.reshape(self.pixels, self.pixels)
