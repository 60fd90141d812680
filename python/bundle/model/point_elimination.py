"""Elimination of points from small normal equations, at NumPy level.

With M = sum J_p^T J_p of a point and V = sum J_p^T [J r], its share of the normal equations of all
other unknowns is -V^T M^-1 V. Directions of a point whose eigenvalue of M is below 1e-12 of the
largest are undetermined, and left out. Points are taken in chunks, so that memory grows with the
number of unknowns only.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bundle.model.problem import Problem

SINGULAR = 1e-12  # eigenvalues below this share of the largest count as zero
_CHUNK = 500

Floats = NDArray[np.float64]


def eliminate_points(
    columns: Floats,
    places: NDArray[np.int64],
    d_point: Floats,
    r: Floats,
    point: NDArray[np.int64],
    size: int,
) -> tuple[Floats, float, int]:
    """Return the normal equations without the points.

    Args:
        columns: (n, 2, m) derivatives of each observation with respect to m unknowns.
        places: (n, m) number of each of these unknowns; -1: the column is left out.
        d_point: (n, 2, 3) derivatives with respect to the point.
        r: (n, 2) residuals.
        point: (n,) number of the point of each observation, from 0 without gaps, ascending.

    Returns:
        Normal equations (size, size + 1) with the right-hand side last, the sum of squares that the
        points leave, and the rank of the points.
    """
    num_points = int(point.max()) + 1
    bounds = np.searchsorted(point, np.arange(0, num_points + _CHUNK, _CHUNK))
    normal, square, rank = np.zeros((size, size + 1)), 0.0, 0
    for low, high in pairwise(bounds):
        if low == high:
            continue
        rows = slice(low, high)
        local = point[rows] - point[low]
        count = int(local[-1]) + 1
        full = np.zeros((high - low, 2, size + 1))
        index = np.arange(high - low)[:, None]
        for k in range(2):
            full[index, k, places[rows]] = columns[rows, k]
        full[:, :, -1] = r[rows]  # also overwrites the columns of no lens parameter
        transposed = np.swapaxes(d_point[rows], 1, 2)
        starts = np.searchsorted(local, np.arange(count))
        v = np.add.reduceat(transposed @ full, starts, axis=0)
        m = np.add.reduceat(transposed @ d_point[rows], starts, axis=0)
        values, vectors = np.linalg.eigh(m)
        is_free = values > SINGULAR * values[:, -1:]
        rank += int(is_free.sum())
        scale = np.where(is_free, 1 / np.sqrt(np.where(is_free, values, 1.0)), 0.0)
        x = (np.swapaxes(vectors * scale[:, None, :], 1, 2) @ v).reshape(-1, size + 1)
        flat = full.reshape(-1, size + 1)
        normal += flat[:, :-1].T @ flat - x[:, :-1].T @ x
        square += float(flat[:, -1] @ flat[:, -1] - x[:, -1] @ x[:, -1])
    return normal, square, rank


# Part of a large problem's observations whose dense normal equations stay small.
#
# The images are those that share the most points with the image of the most observations, and the
# points are spread evenly over those that at least two of these images see.


def part_of_observations(
    problem: Problem, rows: NDArray[np.int64], most_images: int, most_points: int
) -> NDArray[np.int64]:
    """Return the places in ``rows`` of the observations that take part, ascending.

    ``rows``: (n,) observations to choose from.
    """
    image, point = problem.observation_image[rows], problem.observation_point[rows]
    chosen = np.arange(len(rows))
    number = np.bincount(image, minlength=problem.num_images)
    if (number > 0).sum() > most_images:
        seen = np.zeros(problem.num_points, bool)
        seen[point[image == np.argmax(number)]] = True
        common = np.bincount(image[seen[point]], minlength=problem.num_images)
        taken = np.zeros(problem.num_images, bool)
        taken[np.argsort(-common, kind="stable")[:most_images]] = True
        chosen = chosen[taken[image]]
    tracks = np.bincount(point[chosen], minlength=problem.num_points)
    useful = np.flatnonzero(tracks >= 2)
    if len(useful) > most_points:
        useful = useful[np.linspace(0, len(useful) - 1, most_points).astype(np.int64)]
    kept = np.zeros(problem.num_points, bool)
    kept[useful] = True
    return chosen[kept[point[chosen]]]
