"""Subgraph of a few images of a problem, small enough for an elimination step by step.

Images that share the most points are all connected with each other, so their elimination shows no
fill-in. Therefore images are sampled from the whole problem at even steps. The step is as large as
possible while the sampled images still share points.
"""

from __future__ import annotations

from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.statistics.covisibility import shared_points
from bundle.model.problem import Problem

MOST_IMAGES = 24
# Edges per image that are enough for visible fill-in.
ENOUGH = 1.5


def image_graph(
    problem: Problem, most: int = MOST_IMAGES
) -> tuple[list[str], list[tuple[int, int]]]:
    """Return (names, edges) of up to ``most`` images; empty if no images share a point.

    Images are renumbered in the order of the problem. An edge joins two images that share points,
    that is, images with a block in S.
    """
    low, high, count = shared_points(problem)
    chosen = spread(low, high, problem.num_images, most)
    if len(chosen) == 0:
        chosen = np.sort(best_connected(low, high, count, most))
    number = {int(image): index for index, image in enumerate(chosen)}
    inside = _inside(low, high, chosen)
    edges = [
        (number[int(a)], number[int(b)]) for a, b in zip(low[inside], high[inside], strict=True)
    ]
    return [_name(problem, int(image)) for image in chosen], edges


def spread(
    low: NDArray[np.int64], high: NDArray[np.int64], num_vertices: int, most: int
) -> NDArray[np.int64]:
    """Return up to ``most`` vertices at the largest even step that leaves enough edges.

    Args:
        low: (num_edges,) first vertex of each edge.
        high: (num_edges,) second vertex of each edge.
        num_vertices: number of vertices of the whole graph.
        most: largest number of vertices; vertices without edges to others are omitted.

    Returns:
        (n,) vertices, ascending; empty if no step leaves enough edges.
    """
    step = -(-num_vertices // most)
    while step > 0:
        taken = np.arange(0, num_vertices, step)[:most]
        inside = _inside(low, high, taken)
        kept = np.unique(np.concatenate([low[inside], high[inside]]))
        if len(kept) > len(taken) / 2 and inside.sum() >= ENOUGH * len(kept):
            return kept
        step //= 2
    return np.empty(0, np.int64)


def _inside(
    low: NDArray[np.int64], high: NDArray[np.int64], chosen: NDArray[np.int64]
) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = np.isin(low, chosen) & np.isin(high, chosen)
    return found


def best_connected(
    low: NDArray[np.int64], high: NDArray[np.int64], count: NDArray[np.int64], most: int
) -> NDArray[np.int64]:
    """Return up to ``most`` vertices, grown from the heaviest edge by the largest edge weight.

    Args:
        low: (num_edges,) first vertex of each edge.
        high: (num_edges,) second vertex of each edge.
        count: (num_edges,) weight of each edge.
        most: largest number of vertices; fewer if no further vertex is connected.
    """
    if len(count) == 0:
        return np.empty(0, np.int64)
    ends = np.stack([np.concatenate([low, high]), np.concatenate([high, low])])
    by_first = np.argsort(ends[0], kind="stable")
    first, second, weight = ends[0][by_first], ends[1][by_first], np.tile(count, 2)[by_first]
    bound = np.zeros(first[-1] + 1)
    heaviest = int(np.argmax(count))
    chosen: list[int] = []
    following = int(low[heaviest])
    while len(chosen) < most:
        chosen.append(following)
        begin, end = np.searchsorted(first, [following, following + 1])
        bound[second[begin:end]] += weight[begin:end]
        bound[chosen] = -1.0
        following = int(np.argmax(bound))
        if bound[following] <= 0:
            break
    return np.array(chosen, np.int64)


def _name(problem: Problem, image: int) -> str:
    """Return the last part of an image's name, or its id if the name is empty."""
    return PurePosixPath(problem.image_names[image]).name or f"image {problem.image_ids[image]}"
