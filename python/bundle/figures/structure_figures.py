"""Structure of a reconstruction or a graph: poses with their edges, tracks, errors of edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.track_table import shared_points
from bundle.base.arrays import check_type
from bundle.base.records import dataclass
from bundle.base.tails import chi2_tail
from bundle.base.words import amount, plural
from bundle.figures.marks import (
    GREY,
    Axis,
    Bars,
    Dots,
    Figure,
    Line,
    Mark,
    Vectors,
    logarithmic,
    square,
)
from bundle.interface.option_fields import number
from bundle.model.problem import Problem
from bundle.model.ray_angles import enclose_angle

STRONGEST_OF_EACH = 3
NARROWEST = 0.2  # ratio of height to width below which a graph is stretched
STRENGTHS = 6  # number of opacities of edges


@dataclass(frozen=True, eq=False)
class CovisibilityGraph:
    """Images as points of the plane, and the edges to draw, the weakest first."""

    # (num_images, 2) camera centres in their plane of largest spread, in the reconstruction's
    # length unit; y up
    positions: NDArray[np.float64]
    edges: NDArray[np.int64]  # (num_edges, 2) pairs of images with common points
    weights: NDArray[np.int64]  # (num_edges,) number of their common points
    num_pairs: int  # number of all pairs with common points, drawn or not


def covisibility_graph(problem: Problem, max_edges: int = 4000) -> CovisibilityGraph:
    """Return the graph of a problem, reduced to its most important edges.

    If there are more than ``max_edges`` pairs, the three strongest edges of each image are kept,
    and the strongest of the others up to the limit.
    """
    check_type("problem", problem, Problem)
    max_edges = number("max_edges", max_edges, whole=True, minimum=0)
    low, high, count = shared_points(problem)
    chosen = np.arange(len(count))
    if len(count) > max_edges:
        rank = np.minimum(_rank(low, high, count), STRONGEST_OF_EACH)
        chosen = np.lexsort((-count, rank))[:max_edges]
    chosen = chosen[np.argsort(count[chosen], kind="stable")]
    edges = np.stack([low[chosen], high[chosen]], axis=1)
    return CovisibilityGraph(_plane(problem.projection_centers), edges, count[chosen], len(count))


def covisibility_figure(graph: CovisibilityGraph) -> Figure:
    """Return the graph; cameras far outside, such as those of broken poses, are at the border."""
    positions = within_view(graph.positions)
    strength = np.log1p(graph.weights) / np.log1p(max(int(graph.weights.max(initial=1)), 2))
    kinds = np.minimum((STRENGTHS * strength**2).astype(int), STRENGTHS - 1)
    marks: list[Mark] = []
    for kind in np.unique(kinds).tolist():
        begin, end = positions[graph.edges[kinds == kind]].swapaxes(0, 1)
        marks.append(Vectors(begin, end - begin, 0, opacity=0.08 + 0.6 * (kind + 1) / STRENGTHS))
    radius = float(np.clip(30 / np.sqrt(max(len(positions), 1)), 0.8, 3.4))
    marks.append(Dots(positions, (GREY,) * len(positions), radius=radius))
    low, high = (f(positions, axis=0, initial=0.0) for f in (np.min, np.max))
    x, y = square(low, high, ("", ""))
    # A street seen from above is a line, and edges on a line would overlap.
    half = (high - low) / 2
    stretched = bool(0 < half[1] < NARROWEST * half[0])
    if stretched:
        y = Axis(float(low[1] - half[1]), float(high[1] + half[1]), ())
    words = f"{plural(len(positions), 'image', grouped=True)}, "
    words += f"{plural(graph.num_pairs, 'pair shares points', 'pairs share points', grouped=True)}"
    if len(graph.edges) < graph.num_pairs:
        words += f"; the strongest {len(graph.edges):,} are drawn"
    return Figure(
        name="covisibility",
        title="Co-visibility",
        x=replace(x, ticks=()),
        y=replace(y, ticks=()),
        marks=tuple(marks),
        note=words + ("; height stretched." if stretched else "."),
        is_plan=not stretched,
    )


def within_view(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions; those far outside the middle 90 % are moved to the border."""
    if len(positions) == 0:
        return positions
    low, high = np.percentile(positions, [5, 95], axis=0)
    margin = (high - low).max()
    clipped: NDArray[np.float64] = np.clip(positions, low - margin, high + margin)
    return clipped


def _plane(centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Project centres to their two principal axes, computed without the outermost centres."""
    if len(centres) == 0:
        return np.zeros((0, 2))
    offset = centres - np.median(centres, axis=0)
    distance = np.linalg.norm(offset, axis=1)
    inside = offset[distance <= np.quantile(distance, 0.95)]
    _, _, axes = np.linalg.svd(inside, full_matrices=True)
    axes = axes[:2] * np.sign(axes[:2, [0]] + 1e-300)
    positions: NDArray[np.float64] = offset @ axes.T
    return positions


def _rank(
    low: NDArray[np.int64], high: NDArray[np.int64], count: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the better rank, from 0, of each edge among the edges of its two images."""
    ends, edge = np.concatenate([low, high]), np.tile(np.arange(len(count)), 2)
    by_image = np.lexsort((-count[edge], ends))
    ends, edge = ends[by_image], edge[by_image]
    first = np.searchsorted(ends, ends)
    rank = np.full(len(count), len(count))
    np.minimum.at(rank, edge, np.arange(len(ends)) - first)
    return rank


ANGLES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
LONGEST = 20


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackStatistics:
    """Distributions over the points.

    Attributes:
        lengths: number of points with 0, 1, ... observations; the last entry also counts all longer
            tracks.
        angle_limits: limits of the angle classes in degrees, ascending.
        angles: (len(angle_limits) + 1,) points by the largest angle between two of their rays:
            below the first limit, between consecutive limits, and above the last one. Only points
            with at least two observations are used.
    """

    lengths: NDArray[np.int64]
    angle_limits: tuple[float, ...]
    angles: NDArray[np.int64]


def track_statistics(problem: Problem) -> TrackStatistics:
    """Return the statistics of all points.

    The angle of two rays is at most 90 degrees, as in ``bundle.filter_observations``.
    """
    length = np.bincount(problem.observation_point, minlength=problem.num_points)
    longest = min(int(length.max(initial=0)), LONGEST)
    order = np.argsort(problem.observation_point, kind="stable")
    reached = [int(enclose_angle(problem, order, limit).sum()) for limit in ANGLES]
    twice = int((length >= 2).sum())
    return TrackStatistics(
        lengths=np.bincount(np.minimum(length, longest), minlength=longest + 1),
        angle_limits=ANGLES,
        angles=np.array([twice, *reached]) - np.array([*reached, 0]),
    )


def length_figure(tracks: TrackStatistics, longest: int | None = None) -> Figure:
    """Return the number of points by track length; without ``longest`` the last class is open."""
    last = len(tracks.lengths) - 1
    names = [f"{length}" for length in range(last + 1)]
    names[-1] += " or more" if longest is None or longest > last else ""
    title = "Points by observations, log scale"
    return _bars("track_lengths", title, names, tracks.lengths)


def angle_figure(tracks: TrackStatistics) -> Figure:
    """Return the number of points against the largest angle between two of their rays."""
    limits = tracks.angle_limits
    names = [f"below {limits[0]:g}°"]
    names += [f"{low:g} to {high:g}°" for low, high in pairwise(limits)]
    names.append(f"{limits[-1]:g} to 90°")
    title = "Points by angle of rays, log scale"
    return _bars("triangulation_angles", title, names, tracks.angles)


def _bars(name: str, title: str, names: list[str], counts: NDArray[np.int64]) -> Figure:
    values = dict(zip(names, map(float, counts.tolist()), strict=True))
    return Figure(name=name, title=title, marks=(Bars(values, amount, is_ordered=True),))


Floats = NDArray[np.float64]

MOST_EDGES = 6000  # number of edges that a figure draws; of more, every k-th

AXES = ("x", "y", "z")

QUANTILES = np.linspace(0.0, 1.0, 201)


@dataclass(frozen=True, eq=False)
class DrawnGraph:
    """Positions (n, 2) or (n, 3) to draw, and edges as pairs of them.

    ``path`` are edges along the trajectory, ``worst`` those with the largest errors.
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
    names = (AXES[across], AXES[up])
    x, y = square(*_box(places), names)
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
    expected = 100 * np.array([1 - chi2_tail(value * degrees, degrees) for value in grid])
    marks.append(Line("expected", grid, expected, colour=GREY, dash=1))
    low = max(float(np.quantile(known, 0.02)), 1e-12)
    return Figure(
        name="errors",
        title="Share of edges below chi2 per residual [%]",
        x=logarithmic([low, float(known.max()), 0.1, 5.0], "chi2 per residual, log scale"),
        y=Axis(0.0, 100.0, (0.0, 25.0, 50.0, 75.0, 100.0), label="edges [%]"),
        marks=tuple(marks),
        note=f"Expected: chi2 with {plural(degrees, 'degree')} of freedom. A curve to the left: "
        "the information is too cautious (sigmas too large); to the right: too optimistic.",
    )
