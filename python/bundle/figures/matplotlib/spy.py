"""Nonzero patterns of matrices, readable from 3 rows to a million."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from bundle.figures.matplotlib.density import Density, factor_density, matrix_density
from bundle.figures.matplotlib.draw import figure
from bundle.figures.matplotlib.matrix_pattern import MatrixPattern
from bundle.figures.matplotlib.problem_patterns import ORDERINGS, order_blocks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_orderings", "spy", "spy_factor"]


def spy(
    ax: Axes,
    pattern: MatrixPattern | tuple[ArrayLike, ArrayLike, ArrayLike],
    order: ArrayLike | None = None,
    *,
    title: str = "",
    pixels: int = 400,
) -> None:
    """Draw a symmetric matrix, both triangles; the darker a pixel, the fuller, on a log scale.

    Args:
        ax: where.
        pattern: of the matrix, or (sizes, column_begin, rows) of its lower block triangle.
        order: the block in each place; the pattern's own without one.
        title: above the picture.
        pixels: of the picture's side, at most one per row of the matrix.

    Raises:
        InputError: pattern or order are none.
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
    """Draw the Cholesky factor of a matrix, its lower triangle; fill is orange.

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
    """Return a figure with a matrix above its factor, a column for each order.

    Args:
        pattern: of the matrix, or (sizes, column_begin, rows) of its lower block triangle.
        orders: names of orderings, or the blocks of each in order under the name to show.
        name: of the matrix.
        pixels: of each picture's side.

    Raises:
        InputError: pattern or order are none, or Matplotlib is not installed.
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
