"""Matrices and graphs as pictures of the page."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np
from numpy.typing import ArrayLike

from bundle.figures.matplotlib.covisibility_graph import CovisibilityGraph, within_view
from bundle.figures.matplotlib.density import Density, factor_density, matrix_density
from bundle.figures.matplotlib.matrix_pattern import MatrixPattern
from bundle.reports.page.page import tag
from bundle.reports.page.pictures import data_uri

__all__ = ["covisibility", "matrix", "orderings"]

PIXELS = 400
# Edges of about the same weight are one path; this many paths, of increasing opacity.
STRENGTHS = 6
SIDE = 480
NARROWEST = 120


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


def covisibility(graph: CovisibilityGraph) -> str:
    """Return the co-visibility graph: images at their positions, joined by shared points."""
    positions = within_view(graph.positions)
    if len(positions) == 0:
        return ""
    low, high = positions.min(0), positions.max(0)
    scale = (SIDE - 20) / max(float((high - low).max()), 1e-12)
    across = max((high[1] - low[1]) * scale, 1e-12)
    # A street seen from above is a line, and edges on a line would overlap.
    stretch = max(NARROWEST / across, 1.0) if across < NARROWEST else 1.0
    x = 10 + (positions[:, 0] - low[0]) * scale
    y = 10 + (high[1] - positions[:, 1]) * scale * min(stretch, 1e6)
    strength = np.log1p(graph.weights) / np.log1p(max(int(graph.weights.max(initial=1)), 2))
    kinds = np.minimum((STRENGTHS * strength**2).astype(int), STRENGTHS - 1)
    paths = []
    for kind in range(STRENGTHS):
        drawn = "".join(
            f"M{x[a]:.1f} {y[a]:.1f}L{x[b]:.1f} {y[b]:.1f}" for a, b in graph.edges[kinds == kind]
        )
        weak = (kind + 1) / STRENGTHS
        look = {"stroke_opacity": round(0.08 + 0.6 * weak, 2), "stroke_width": 0.4 + weak}
        paths.append(tag("path", d=drawn, **look) if drawn else "")
    radius = round(float(np.clip(30 / np.sqrt(len(positions)), 0.6, 4.0)), 2)
    nodes = [
        tag("circle", cx=f"{a:.1f}", cy=f"{b:.1f}", r=radius) for a, b in zip(x, y, strict=True)
    ]
    size = f"0 0 {SIDE} {y.max() + 10:.0f}"
    drawing = tag("svg", *paths, *nodes, viewBox=size, class_="covisibility", role="img",
                  aria_label="co-visibility graph")  # fmt: skip
    words = f"{len(positions):,} images, {graph.num_pairs:,} pairs share points"
    if len(graph.edges) < graph.num_pairs:
        words += f"; the strongest {len(graph.edges):,} are drawn"
    words += "; height stretched" if stretch > 1 else ""
    return tag("figure", drawing, tag("figcaption", words + "."))


def _figure(density: Density, name: str, convention: str) -> str:
    words = f"{name}: {density.num_nonzeros:,} nonzeros ({convention})"
    if density.fill.any():
        words += f", {round(float(density.fill.sum())):,} of them fill"
    if len(density.entries) == 0:
        return tag("figure", tag("figcaption", escape(words)))
    image = tag("img", src=data_uri(density.rgba()), alt=words, class_="spy")
    return tag("figure", tag("div", image, class_="frame"), tag("figcaption", escape(words)))
