"""Covisibility graph of images: the structure of the reduced camera matrix S.

Block (i, j) of S is nonzero exactly if images i and j observe a common point (as long as no two
images share a refined camera). The density of this graph is therefore the fill of S.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bundle.base.components import component_roots
from bundle.base.records import dataclass
from bundle.model.problem import Problem

# Entries of the adjacency matrix in memory at once: 128 MB of booleans.
_CELLS = 2**27


@dataclass(frozen=True, eq=False, kw_only=True)
class Covisibility:
    """Covisibility graph of the images.

    Attributes:
        neighbours: (num_images,) number of other images that share a point with each image.
        num_pairs: pairs of images with a common point.
        schur_fill: share of nonzero image blocks of S, including the diagonal; NaN without images.
        component: (num_images,) connected component of each image, the largest component first; -1
            for an image without observations.
        component_sizes: number of images of each component.
    """

    neighbours: NDArray[np.int64]
    num_pairs: int
    schur_fill: float
    component: NDArray[np.int64]
    component_sizes: tuple[int, ...]


def covisibility(problem: Problem) -> Covisibility:
    """Return the covisibility graph in time linear in the pairs of images that points connect."""
    images, points = by_point(problem)
    neighbours = _neighbours(images, points, problem.num_images)
    component, sizes = components(images, points, problem.num_images)
    num_pairs, size = int(neighbours.sum()) // 2, problem.num_images
    return Covisibility(
        neighbours=neighbours,
        num_pairs=num_pairs,
        schur_fill=(size + 2 * num_pairs) / size**2 if size else float("nan"),
        component=component,
        component_sizes=sizes,
    )


def shared_points(
    problem: Problem,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return (low, high, number of common points) of each pair of covisible images, ascending.

    Time is linear in the pairs of images that points connect, memory in the distinct ones.
    """
    images, points = by_point(problem)
    size = max(problem.num_images, 1)
    codes, counts = np.empty(0, np.int64), np.empty(0, np.int64)
    for low, high in _pairs(np.arange(len(images)), images, points):
        found, count = np.unique(low * size + high, return_counts=True)
        codes, place = np.unique(np.concatenate([codes, found]), return_inverse=True)
        both = np.concatenate([counts, count])
        counts = np.bincount(place, both, len(codes)).astype(np.int64)
    low, high = np.divmod(codes, size)
    return low, high, counts


def components(
    images: NDArray[np.int64], points: NDArray[np.int64], num_images: int
) -> tuple[NDArray[np.int64], tuple[int, ...]]:
    """Return the component of each image (-1: no observation) and the sizes, largest first.

    Observations must be sorted by point.
    """
    starts = np.flatnonzero(np.diff(points, prepend=-1))
    root = component_roots(images, starts, num_images)
    observed = np.zeros(num_images, bool)
    observed[images] = True
    component = np.full(num_images, -1)
    _, component[observed], sizes = np.unique(
        root[observed], return_inverse=True, return_counts=True
    )
    order = np.argsort(-sizes, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    component[observed] = rank[component[observed]]
    return component, tuple(int(size) for size in sizes[order])


def by_point(problem: Problem) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return images and points of all distinct observed pairs, sorted by point, then image."""
    size = max(problem.num_images, 1)
    code = np.sort(problem.observation_point.astype(np.int64) * size + problem.observation_image)
    points, images = np.divmod(code[np.diff(code, prepend=-1) != 0], size)
    return images, points


def _neighbours(
    images: NDArray[np.int64], points: NDArray[np.int64], num_images: int
) -> NDArray[np.int64]:
    """Return the number of neighbours of each image, computed in blocks of adjacency rows."""
    neighbours = np.zeros(num_images, np.int64)
    rows = max(_CELLS // max(num_images, 1), 1)
    for first in range(0, num_images, rows):
        adjacent = np.zeros((min(rows, num_images - first), num_images), bool)
        inside = np.flatnonzero((images >= first) & (images < first + rows))
        for low, high in _pairs(inside, images, points):
            adjacent[low - first, high] = True
        neighbours[first : first + rows] += adjacent.sum(1)
        neighbours += adjacent.sum(0)
    return neighbours


def _pairs(
    chosen: NDArray[np.int64], images: NDArray[np.int64], points: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield the pairs (low, high) of images on common points, low among the chosen observations.

    Round k pairs each observation with the k-th after it on the same point.
    """
    step = 1
    while True:
        chosen = chosen[chosen + step < len(points)]
        chosen = chosen[points[chosen] == points[chosen + step]]
        if len(chosen) == 0:
            return
        yield images[chosen], images[chosen + step]
        step += 1
