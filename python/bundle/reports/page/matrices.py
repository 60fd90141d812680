"""Matrices as pictures of the page."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from numpy.typing import ArrayLike

from bundle.figures.matplotlib.matrix_pattern import (
    Density,
    MatrixPattern,
    factor_density,
    matrix_density,
)
from bundle.reports.page.page import tag
from bundle.reports.page.pictures import data_uri

PIXELS = 400


def matrix(pattern: MatrixPattern, name: str) -> str:
    """Return the drawing of a symmetric matrix with both triangles."""
    return _figure(matrix_density(pattern, pixels=PIXELS), name, "both triangles and the diagonal")


def orderings(
    pattern: MatrixPattern, orders: Mapping[str, ArrayLike | None], name: str = "S"
) -> str:
    """Return the drawings of a matrix and of its factor under each order, fill-in in orange."""
    figures = []
    for label, order in orders.items():
        ordered = pattern.permuted(order)
        above = matrix_density(ordered, pixels=PIXELS)
        below = factor_density(ordered, pixels=PIXELS)
        figures += [
            tag("div",
                _figure(above, f"{name}, {label}", "both triangles and the diagonal"),
                _figure(below, f"L, {label}", "lower triangle and diagonal"))
        ]  # fmt: skip
    return tag("div", *figures, class_="grid spies")


def _figure(density: Density, name: str, convention: str) -> str:
    words = f"{name}: {density.num_nonzeros:,} nonzeros ({convention})"
    if density.fill.any():
        words += f", {round(float(density.fill.sum())):,} of them fill"
    if len(density.entries) == 0:
        return tag("figure", tag("figcaption", escape(words)))
    image = tag("img", src=data_uri(density.rgba()), alt=words, class_="spy")
    return tag("figure", tag("div", image, class_="frame"), tag("figcaption", escape(words)))
