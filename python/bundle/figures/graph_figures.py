"""Figures of a graph: its poses and edges from above, and its errors against their expectation."""

from __future__ import annotations

from collections.abc import Sequence
from math import erf, sqrt

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.figures.drawing import Figure
from bundle.figures.marks import GREY, Axis, Line, Mark, Vectors, logarithmic, square

Floats = NDArray[np.float64]

MOST_EDGES = 6000
"""Number of edges that a figure draws; of more, every k-th."""

AXES = ("x", "y", "z")

QUANTILES = np.linspace(0.0, 1.0, 201)


@dataclass(frozen=True, eq=False)
class DrawnGraph:
    """Positions and edges to draw.

    Attributes:
        positions: (n, 2) or (n, 3), finite.
        before: positions before a solve; None without one.
        path: (k, 2) pairs of positions: edges along the trajectory.
        others: (m, 2) pairs of positions: all other edges.
        worst: (w, 2) pairs of positions of the edges with the largest errors.
    """

    positions: Floats
    before: Floats | None
    path: NDArray[np.int64]
    others: NDArray[np.int64]
    worst: NDArray[np.int64]


def plan_figures(graph: DrawnGraph) -> list[Figure]:
    """Return the graph from above, and for three dimensions also from two sides."""
    if not len(graph.positions):
        return []
    views = [(0, 1)] if graph.positions.shape[1] == 2 else [(0, 1), (0, 2), (1, 2)]
    return [_plan(graph, *view) for view in views]


def _plan(graph: DrawnGraph, across: int, up: int) -> Figure:
    view = [across, up]
    places = graph.positions[:, view]
    marks: list[Mark] = []
    if graph.before is not None and np.isfinite(graph.before).any():
        low, high = _box(places)
        margin = 0.5 * (high - low).max()
        earlier = _segments(graph.before[:, view], graph.path)
        outside = (earlier < low - margin) | (earlier > high + margin)
        earlier[outside.any(axis=1)] = np.nan
        marks.append(_line("before", earlier, GREY, dash=2, opacity=0.7))
    others = _thinned(graph.others)
    marks.append(_line("trajectory", _segments(places, _thinned(graph.path)), 0))
    marks.append(_line("other edges", _segments(places, others), 2, opacity=0.6))
    if len(graph.worst):
        begin, end = places[graph.worst].swapaxes(0, 1)
        marks.append(_line("worst edges", _segments(places, graph.worst), 1))
        marks.append(Vectors(begin, end - begin, 1))
    low, high = _box(places)
    middle = (low + high) / 2
    reach = max(float((high - low).max()) / 2 * 1.05, 1e-9)
    names = (AXES[across], AXES[up])
    x, y = square((float(middle[0]), float(middle[1])), reach, names)
    drawn = len(others) < len(graph.others)
    return Figure(
        name=f"plan_{names[0]}{names[1]}",
        title="From above" if (across, up) == (0, 1) else f"{names[0]} and {names[1]}",
        x=x,
        y=y,
        marks=tuple(marks),
        note=f"{len(others):,} of {plural(len(graph.others), 'other edge', grouped=True)} drawn."
        if drawn
        else "",
        is_plan=True,
    )


def _line(label: str, places: Floats, colour: int, *, dash: int = 0, opacity: float = 1.0) -> Line:
    return Line(label, places[:, 0], places[:, 1], colour=colour, dash=dash, opacity=opacity)


def _box(places: Floats) -> tuple[Floats, Floats]:
    return places.min(axis=0), places.max(axis=0)


def _thinned(edges: NDArray[np.int64]) -> NDArray[np.int64]:
    return edges[:: max(1, -(-len(edges) // MOST_EDGES))]


def _segments(places: Floats, edges: NDArray[np.int64]) -> Floats:
    """Return the ends of edges as one line; chains continue, and NaN separates other edges."""
    if not len(edges):
        return np.zeros((0, 2))
    continues = np.append(edges[1:, 0] == edges[:-1, 1], False)
    rows = np.full((len(edges), 3, 2), np.nan)
    rows[:, 0], rows[:, 1] = places[edges[:, 0]], places[edges[:, 1]]
    kept = np.ones((len(edges), 3), bool)
    kept[:, 2] = ~continues
    kept[1:, 0] = ~continues[:-1]
    return rows[kept]


def error_figure(chi2: Floats, sizes: NDArray[np.int64], kinds: Sequence[str]) -> Figure | None:
    """Return the share of edges below a chi2 per residual, by kind, with its expectation.

    ``sizes`` are numbers of residuals; all arguments have an entry per edge.
    """
    ratio = chi2 / np.maximum(sizes, 1)
    known = ratio[np.isfinite(ratio) & (ratio > 0)]
    if not len(known):
        return None
    names = list(dict.fromkeys(kinds))
    marks: list[Mark] = []
    for k, name in enumerate(names):
        values = ratio[np.asarray(kinds) == name]
        values = np.sort(values[np.isfinite(values) & (values > 0)])
        if len(values):
            shown = np.quantile(values, QUANTILES)
            marks.append(Line(name, shown, 100 * QUANTILES, colour=k))
    degrees = int(np.median(sizes))
    grid = np.geomspace(1e-3, 20, 200)
    expected = 100 * np.array([_share_below(value * degrees, degrees) for value in grid])
    marks.append(Line("expected", grid, expected, colour=GREY, dash=1))
    low = max(float(np.quantile(known, 0.02)), 1e-12)
    return Figure(
        name="errors",
        title="Share of edges below chi2 per residual [%]",
        x=logarithmic([low, float(known.max()), 0.1, 5.0], "chi2 per residual, log scale"),
        y=Axis(0.0, 100.0, (0.0, 25.0, 50.0, 75.0, 100.0), label="edges [%]"),
        marks=tuple(marks),
        note=f"Expected: chi2 with {plural(degrees, 'degree')} of freedom. A curve to the left has "
        "information that is too cautious, a curve to the right too optimistic.",
    )


def _share_below(chi2: float, degrees: int) -> float:
    """Return the distribution function of chi2 (Wilson and Hilferty)."""
    variance = 2 / (9 * degrees)
    normal = ((chi2 / degrees) ** (1 / 3) - (1 - variance)) / sqrt(variance)
    return 0.5 * (1 + erf(normal / sqrt(2)))
