"""Part of a large problem's observations whose dense normal equations stay small.

The images are those that share the most points with the image of the most observations, and the
points are spread evenly over those that at least two of these images see.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.model.problem import Problem


def part_of_observations(
    problem: Problem, rows: NDArray[np.int64], most_images: int, most_points: int
) -> NDArray[np.int64]:
    """Return the places in ``rows`` of the observations that take part, ascending.

    Args:
        problem: the problem.
        rows: (n,) observations to choose from.
        most_images: largest number of images.
        most_points: largest number of points.
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
