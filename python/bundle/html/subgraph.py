"""A few images of a problem that are bound to each other most, as a graph small enough to step."""

from __future__ import annotations

from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from bundle.problem import Problem
from bundle.statistics.covisibility import shared_points

__all__ = ["best_connected", "image_graph"]

MOST_IMAGES = 24


def image_graph(
    problem: Problem, most: int = MOST_IMAGES
) -> tuple[list[str], list[tuple[int, int]]]:
    """Return (names, edges) of up to ``most`` images that share many points with each other.

    Images are numbered anew, in the order of the problem. An edge is a block of S between two
    images, so that eliminating them makes the fill that the factor of their part of S has.
    """
    low, high, count = shared_points(problem)
    chosen = np.sort(best_connected(low, high, count, most))
    number = {int(image): index for index, image in enumerate(chosen)}
    inside = np.isin(low, chosen) & np.isin(high, chosen)
    edges = [
        (number[int(a)], number[int(b)]) for a, b in zip(low[inside], high[inside], strict=True)
    ]
    return [_name(problem, int(image)) for image in chosen], edges


def best_connected(
    low: NDArray[np.int64], high: NDArray[np.int64], count: NDArray[np.int64], most: int
) -> NDArray[np.int64]:
    """Return up to ``most`` vertices: the heaviest edge's, then always the one bound most to them.

    Args:
        low: (num_edges,) one vertex of each edge.
        high: (num_edges,) the other.
        count: (num_edges,) its weight.
        most: vertices wanted; fewer come where no edge leads on.
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
    """Return the last part of an image's name, or its id where it has none."""
    return PurePosixPath(problem.image_names[image]).name or f"image {problem.image_ids[image]}"
