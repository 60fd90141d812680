"""By how many pixels two points that should be one differ, in the images that see either.

The distance between the projections of both, not to the keypoints: what it tells is whether the
points are one, not whether they were measured well. The median over the images of both tracks, so
that a misplaced image decides nothing. An image in front of which only one of them is counts as
infinitely far.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.model.cameras import camera_models, project
from bundle.model.problem import Problem
from bundle.model.rotations import rotation_matrices

__all__ = ["disagreements"]

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def disagreements(a: Problem, b: Problem, pairs: Indices) -> Array:
    """Return the median distance of each pair in pixels.

    Args:
        a: the first model.
        b: the second, in the frame of the first.
        pairs: (n, 2) indices of a point of A and of one of B.
    """
    first, second = a.points[pairs[:, 0]], b.points[pairs[:, 1]]
    rows, distances = [], []
    for problem, point in ((a, pairs[:, 0]), (b, pairs[:, 1])):
        row, image = _views(problem, point)
        here = _pixels(problem, image, first[row])
        there = _pixels(problem, image, second[row])
        distance = np.linalg.norm(here - there, axis=1)
        rows.append(row)
        distances.append(np.where(np.isnan(distance), np.inf, distance))
    row, distance = np.concatenate(rows), np.concatenate(distances)
    order = np.lexsort((distance, row))
    counts = np.bincount(row, minlength=len(pairs))
    # The lower of the two in the middle, as the mean of them may be infinite.
    middle = np.cumsum(counts) - counts + (counts - 1) // 2
    median: Array = distance[order][middle]
    return median


def _views(problem: Problem, points: Indices) -> tuple[Indices, Indices]:
    """Return for each observation of each point its row in ``points`` and its image."""
    order = np.argsort(problem.observation_point, kind="stable")
    counts = np.bincount(problem.observation_point, minlength=problem.num_points)
    starts = np.cumsum(counts) - counts
    length = counts[points]
    row = np.repeat(np.arange(len(points)), length)
    within = np.arange(len(row)) - np.repeat(np.cumsum(length) - length, length)
    observation = order[starts[points][row] + within]
    return row, problem.observation_image[observation].astype(np.int64)


def _pixels(problem: Problem, image: Indices, points: Array) -> Array:
    """Return (n, 2) projections, nan where the camera cannot see the point."""
    turned = np.einsum("nij,nj->ni", rotation_matrices(problem.cam_from_world[image, :4]), points)
    in_camera = turned + problem.cam_from_world[image, 4:]
    pixels = np.full((len(image), 2), np.nan)
    camera = problem.image_camera[image]
    for index in np.unique(camera):
        rows = camera == index
        model = problem.camera_models[index]
        params = problem.camera_params[index, : len(camera_models()[model])]
        found, valid = project(model, params, in_camera[rows])
        pixels[rows] = np.where(valid[:, None], found, np.nan)
    return pixels
