"""Nonzero patterns of matrices of 3 to a million rows, in readable form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import check_type
from bundle.figures.matplotlib.draw import figure
from bundle.figures.matplotlib.matrix_pattern import (
    Density,
    MatrixPattern,
    factor_density,
    matrix_density,
)
from bundle.interface.option_fields import choice
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.solving.layout import resolve_defaults

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ORDERINGS = ("natural", "amd", "colamd", "metis", "nesdis")
"""Orders of the blocks of S; all but the first are CHOLMOD's."""


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
