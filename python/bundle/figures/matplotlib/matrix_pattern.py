"""Nonzero patterns of block matrices under any block order, and their pictures (``spy``)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import as_integers, check_shape, check_type
from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.figures.matplotlib.draw import figure
from bundle.interface.option_fields import choice, number
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.solving.layout import resolve_defaults

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class MatrixPattern:
    """Lower triangle of a symmetric pattern by block columns, in the core's format.

    Attributes:
        sizes: (num_blocks,) scalar unknowns of each block.
        column_begin: (num_blocks + 1,) first entry of each block column in ``rows``.
        rows: block rows of each column, ascending, the diagonal first.

    Raises:
        InputError: the arrays do not describe a lower triangle.
    """

    sizes: NDArray[np.int64]
    column_begin: NDArray[np.int64]
    rows: NDArray[np.int64]

    def __post_init__(self) -> None:
        for name in ("sizes", "column_begin", "rows"):
            object.__setattr__(self, name, _row(name, getattr(self, name)))
        begin, rows = self.column_begin, self.rows
        if len(begin) != len(self.sizes) + 1 or begin[0] != 0 or begin[-1] != len(rows):
            raise InputError(
                f"column_begin: expected {len(self.sizes) + 1} numbers from 0 to {len(rows)}, "
                f"found {len(begin)} from {begin[:1]} to {begin[-1:]}"
            )
        if len(rows) and (rows.max() >= len(self.sizes) or (rows < self.columns).any()):
            raise InputError("rows: expected the lower triangle, found an entry above or outside")

    @classmethod
    def from_edges(cls, num_blocks: int, edges: ArrayLike, sizes: Sequence[int] | int = 1) -> Self:
        """Return the pattern of a graph: its edges and the diagonal; repeated edges are allowed."""
        num_blocks = number("num_blocks", num_blocks, whole=True, minimum=0)
        pairs = as_integers("edges", edges)
        if pairs.size:
            check_shape("edges", pairs, ("num_edges", 2))
        pairs = np.sort(pairs.reshape(-1, 2), axis=1)
        if pairs.size and not 0 <= pairs.min() <= pairs.max() < num_blocks:
            raise InputError(
                f"edges: expected blocks 0 to {num_blocks - 1}, "
                f"found {pairs.min()} to {pairs.max()}"
            )
        diagonal = np.arange(num_blocks)
        code = np.unique(
            np.concatenate([pairs[:, 0] * num_blocks + pairs[:, 1], diagonal * (num_blocks + 1)])
        )
        columns, rows = np.divmod(code, max(num_blocks, 1))
        begin = np.searchsorted(columns, np.arange(num_blocks + 1))
        return cls(np.broadcast_to(np.asarray(sizes, np.int64), num_blocks), begin, rows)

    @cached_property
    def columns(self) -> NDArray[np.int64]:
        """Block column of each entry of ``rows``."""
        return np.repeat(np.arange(self.num_blocks), np.diff(self.column_begin))

    @property
    def num_blocks(self) -> int:
        """Number of block rows."""
        return len(self.sizes)

    @property
    def num_unknowns(self) -> int:
        """Number of scalar rows."""
        return int(self.sizes.sum())

    @property
    def num_nonzeros(self) -> int:
        """Scalar nonzeros of both triangles and the diagonal."""
        each = self.sizes[self.rows] * self.sizes[self.columns]
        return int((each * np.where(self.rows == self.columns, 1, 2)).sum())

    def permuted(self, order: ArrayLike | None) -> MatrixPattern:
        """Return the pattern with block ``order[k]`` at position k."""
        if order is None:
            return self
        wanted = as_integers("order", order)
        if not np.array_equal(np.sort(wanted), np.arange(self.num_blocks)):
            raise InputError(
                f"order: expected each of {self.num_blocks} blocks once, found {len(wanted)} "
                f"numbers, {len(np.unique(wanted))} of them distinct"
            )
        place = np.empty_like(wanted)
        place[wanted] = np.arange(len(wanted))
        row, column = place[self.rows], place[self.columns]
        low, high = np.minimum(row, column), np.maximum(row, column)
        by_column = np.lexsort((high, low))
        begin = np.searchsorted(low[by_column], np.arange(self.num_blocks + 1))
        return MatrixPattern(self.sizes[wanted], begin, high[by_column])

    @classmethod
    def of(cls, triple: Any) -> MatrixPattern:
        """Return a pattern from (sizes, column_begin, rows); a pattern is returned unchanged."""
        if isinstance(triple, MatrixPattern):
            return triple
        if not isinstance(triple, tuple | list) or len(triple) != 3:
            raise InputError(
                "pattern: expected a MatrixPattern or (sizes, column_begin, rows), "
                f"found {brief(triple)}"
            )
        return cls(*triple)


def _row(name: str, values: Any) -> NDArray[np.int64]:
    row = as_integers(name, values)
    if row.ndim != 1:
        raise InputError(f"{name}: expected integers in one row, found shape {row.shape}")
    return row


def factor_columns(pattern: MatrixPattern) -> Iterator[NDArray[np.int32]]:
    """Yield the block rows of each column of L, ascending, the diagonal first.

    Below the diagonal, column j of L has the rows of column j of the matrix and those of its
    children in the elimination tree. The children are the columns whose first entry below the
    diagonal is j (Davis, Direct Methods for Sparse Linear Systems, 4.1). A column is discarded once
    its parent has used it, so L is never in memory as a whole.
    """
    begin, rows = pattern.column_begin, pattern.rows.astype(np.int32)
    waiting: dict[int, list[NDArray[np.int32]]] = {}
    held = np.zeros(pattern.num_blocks, bool)
    for column in range(pattern.num_blocks):
        held[column] = True
        held[rows[begin[column] : begin[column + 1]]] = True
        for child in waiting.pop(column, ()):
            held[child] = True
        found = (column + np.flatnonzero(held[column:])).astype(np.int32)
        held[found] = False
        if len(found) > 1:
            waiting.setdefault(int(found[1]), []).append(found[1:])
        yield found


# Patterns of any size as small images: number of nonzeros per pixel.
#
# If a matrix with 30,000 rows is drawn 400 pixels wide, a pixel covers 75 x 75 cells. Drawing each
# nonzero as a dot would make the pixel black for one nonzero as well as for all 5,625. Therefore
# nonzeros are counted per pixel; a block over several pixels counts by the share of each pixel. The
# grey level is logarithmic in the count: a single nonzero stays visible, and a full pixel differs
# from one that is 10 % full.

# Darkness of a pixel with a single nonzero among many cells; a full pixel has 1.
FAINTEST = 0.28
FILL_COLOUR = (217, 72, 15)
# Counts are sums of fractions; smaller counts are treated as zero.
ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class Density:
    """Nonzeros per pixel of a square matrix."""

    entries: NDArray[np.float64]  # (pixels, pixels) nonzeros of the matrix; fractional in blocks
    fill: NDArray[np.float64]  # (pixels, pixels) nonzeros of the factor that the matrix lacks
    num_unknowns: int  # scalar rows of the matrix

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


ORDERINGS = ("natural", "amd", "colamd", "metis", "nesdis", "minimum_fill")
"""Orders of the blocks of S; all but the first and the last are CHOLMOD's."""


def reduced_pattern(problem: Problem, options: SolveOptions | None = None) -> MatrixPattern:
    """Return the pattern of the reduced camera system S; images with shared points are coupled.

    Raises:
        InputError: the options are invalid for the problem.
    """
    given = _given(problem, options)
    return MatrixPattern.of(_core.reduced_pattern(problem, given))


def information_pattern(problem: Problem, options: SolveOptions | None = None) -> MatrixPattern:
    """Return the pattern of the information matrix, an arrowhead: first points, then cameras.

    Raises:
        InputError: the options are invalid for the problem.
    """
    given = _given(problem, options)
    return MatrixPattern.of(_core.full_pattern(problem, given))


def order_blocks(pattern: MatrixPattern, ordering: str) -> NDArray[np.int32]:
    """Return the blocks of a pattern in the elimination order of a method.

    Raises:
        InputError: the method does not exist.
    """
    check_type("pattern", pattern, MatrixPattern)
    return _core.order_blocks(
        pattern.sizes.astype(np.int32),
        pattern.column_begin,
        pattern.rows.astype(np.int32),
        choice("ordering", ordering, ORDERINGS),
    )


def _given(problem: Problem, options: SolveOptions | None) -> dict[str, object]:
    check_type("problem", problem, Problem)
    return resolve_defaults(problem, SolveOptions.of(options, {}, "options")).asdict()


def spy(
    ax: Axes,
    pattern: MatrixPattern | tuple[ArrayLike, ArrayLike, ArrayLike],
    order: ArrayLike | None = None,
    *,
    title: str = "",
    pixels: int = 400,
) -> None:
    """Draw a symmetric matrix, both triangles; darkness is the share of nonzeros, on a log scale.

    Args:
        ax: axis to draw on.
        pattern: pattern of the matrix, or (sizes, column_begin, rows) of its lower triangle.
        order: block at each position; by default the order of the pattern.
        title: title above the picture.
        pixels: side length of the picture in pixels; at most one per row of the matrix is used.

    Raises:
        InputError: pattern or order are invalid.
    """
    density = matrix_density(MatrixPattern.of(pattern), order, pixels)
    _draw(ax, density, title)
    ax.set_xlabel(f"{density.num_nonzeros:,} nonzeros, both triangles and diagonal", fontsize=8)


def spy_factor(
    ax: Axes,
    pattern: MatrixPattern | tuple[ArrayLike, ArrayLike, ArrayLike],
    order: ArrayLike | None = None,
    *,
    title: str = "",
    pixels: int = 400,
) -> None:
    """Draw the Cholesky factor of a matrix, its lower triangle, with fill-in in orange.

    Arguments and errors are those of ``spy``.
    """
    density = factor_density(MatrixPattern.of(pattern), order, pixels)
    _draw(ax, density, title)
    ax.set_xlabel(f"{density.num_nonzeros:,} nonzeros, lower triangle and diagonal", fontsize=8)


def draw_orderings(
    pattern: MatrixPattern | tuple[ArrayLike, ArrayLike, ArrayLike],
    orders: Mapping[str, ArrayLike | None] | Sequence[str] = ORDERINGS,
    *,
    name: str = "S",
    pixels: int = 400,
) -> Figure:
    """Return a figure with a matrix above its factor, one column per order.

    Args:
        pattern: pattern of the matrix, or (sizes, column_begin, rows) of its lower triangle.
        orders: names of orderings, or permutations of the blocks by display name.
        name: name of the matrix.
        pixels: side length of each picture.

    Raises:
        InputError: pattern or order are invalid, or Matplotlib is not installed.
    """
    pattern = MatrixPattern.of(pattern)
    if not isinstance(orders, Mapping):
        orders = {ordering: order_blocks(pattern, ordering) for ordering in orders}
    made, axes = figure(2, max(len(orders), 1), width=3.4, height=3.6)
    for column, (label, order) in enumerate(orders.items()):
        spy(axes[0, column], pattern, order, title=f"{name}, {label}", pixels=pixels)
        spy_factor(axes[1, column], pattern, order, title=f"L, {label}", pixels=pixels)
    return made


def _draw(ax: Axes, density: Density, title: str) -> None:
    size = max(density.num_unknowns, 1)
    image: Any = density.rgba()
    if image.size:
        interpolation = "nearest" if size <= 2 * len(image) else "antialiased"
        ax.imshow(image, extent=(0, size, size, 0), interpolation=interpolation)
    ax.set(xlim=(0, size), ylim=(size, 0), aspect="equal")
    ax.set_title(title, fontsize=10, pad=8)
    ax.xaxis.tick_top()
    ax.tick_params(labelsize=7)
    ax.locator_params(nbins=4, integer=True)
