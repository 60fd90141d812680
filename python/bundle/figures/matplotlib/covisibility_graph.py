"""Co-visibility graph: images at their positions, joined by shared points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.statistics.covisibility import shared_points
from bundle.base.arguments import check_type
from bundle.interface.option_fields import number
from bundle.model.problem import Problem

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["CovisibilityGraph", "covisibility_graph", "draw_covisibility"]

STRONGEST_OF_EACH = 3
# Ratio of height to width below which a graph is stretched.
NARROWEST = 0.15


@dataclass(frozen=True, eq=False)
class CovisibilityGraph:
    """Images as points of the plane, and the edges to draw, the weakest first.

    Attributes:
        positions: (num_images, 2) camera centres in their plane of largest spread, in the
            reconstruction's length unit; y up.
        edges: (num_edges, 2) pairs of images with common points.
        weights: (num_edges,) number of their common points.
        num_pairs: number of all pairs with common points, drawn or not.
    """

    positions: NDArray[np.float64]
    edges: NDArray[np.int64]
    weights: NDArray[np.int64]
    num_pairs: int


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


def draw_covisibility(ax: Axes, problem: Problem, max_edges: int = 4000) -> None:
    """Draw the co-visibility graph with the images at their camera centres.

    Darker edges have more shared points. Cameras far outside, such as those of broken poses, are
    drawn at the border.
    """
    from matplotlib.collections import LineCollection

    graph = covisibility_graph(problem, max_edges)
    positions = within_view(graph.positions)
    strength = np.log1p(graph.weights) / np.log1p(graph.weights.max(initial=2))
    colours = np.zeros((len(strength), 4))
    colours[:, :3] = (0.06, 0.43, 0.71)
    colours[:, 3] = 0.06 + 0.6 * strength**2
    lines = LineCollection([*positions[graph.edges]], colors=colours, linewidths=0.3 + strength)
    ax.add_collection(lines)
    size = np.clip(3000 / max(len(positions), 1), 1.5, 30)
    ax.scatter(positions[:, 0], positions[:, 1], s=size, color="0.1", zorder=2, linewidths=0)
    along, across = np.ptp(positions, axis=0) if len(positions) else (1.0, 1.0)
    stretched = across < NARROWEST * along
    ax.set(aspect="auto" if stretched else "equal", xticks=[], yticks=[], title="co-visibility")
    ax.autoscale_view()
    words = f"{len(positions):,} images, {graph.num_pairs:,} pairs"
    if len(graph.edges) < graph.num_pairs:
        words += f", the strongest {len(graph.edges):,}"
    ax.set_xlabel(words + ("; height stretched" if stretched else ""), fontsize=8)


def within_view(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return positions; those far outside the middle 90 % are moved to the border."""
    if len(positions) == 0:
        return positions
    low, high = np.percentile(positions, [5, 95], axis=0)
    margin = (high - low).max()
    clipped: NDArray[np.float64] = np.clip(positions, low - margin, high + margin)
    return clipped


def _plane(centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return centres in the plane of their two principal axes, computed without outermost ones."""
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
    """Return the rank of each edge among the edges of its images, the better of two, from 0."""
    ends, edge = np.concatenate([low, high]), np.tile(np.arange(len(count)), 2)
    by_image = np.lexsort((-count[edge], ends))
    ends, edge = ends[by_image], edge[by_image]
    first = np.searchsorted(ends, ends)
    rank = np.full(len(count), len(count))
    np.minimum.at(rank, edge, np.arange(len(ends)) - first)
    return rank
