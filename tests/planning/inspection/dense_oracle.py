"""Patterns as full boolean matrices, and elimination by its definition."""

from __future__ import annotations

import numpy as np

import bundle
from bundle.planning.inspection.problem_time import make_scene


def jacobian_pattern(problem, sizes, image_block, camera_block, is_free):
    """J's pattern (2 num_observations, num_unknowns): the free points, then the blocks."""
    point_column = 3 * (np.cumsum(is_free) - 1)
    begin = 3 * is_free.sum() + np.concatenate([[0], np.cumsum(sizes)])
    pattern = np.zeros((2 * problem.num_observations, begin[-1]), bool)
    for i in range(problem.num_observations):
        image, point = problem.observation_image[i], problem.observation_point[i]
        rows = slice(2 * i, 2 * i + 2)
        if is_free[point]:
            pattern[rows, point_column[point] : point_column[point] + 3] = True
        for block in (image_block[image], camera_block[problem.image_camera[image]]):
            if block >= 0:
                pattern[rows, begin[block] : begin[block + 1]] = True
    return pattern


def factor_pattern(matrix, order):
    """L's pattern in an order of the columns, diagonal included; columns are by position."""
    left = matrix[np.ix_(order, order)].copy()
    for k in range(len(left)):
        below = np.flatnonzero(left[k + 1 :, k]) + k + 1
        left[np.ix_(below, below)] = True
    return np.tril(left)


def eliminate_first(matrix, count):
    """Pattern that remains when the first columns have been eliminated."""
    left = matrix.copy()
    for k in range(count):
        below = np.flatnonzero(left[k + 1 :, k]) + k + 1
        left[np.ix_(below, below)] = True
    return left[count:, count:]


def scalar_order(order, sizes):
    """Columns in the order of their blocks."""
    begin = np.concatenate([[0], np.cumsum(sizes)])
    return np.concatenate([np.arange(begin[block], begin[block + 1]) for block in order])


def drive(num_images, num_points, track_length) -> bundle.Problem:
    """Points that as many images in a row see, the first ones evenly spread."""
    starts = np.arange(num_points) * (num_images - track_length + 1) // num_points
    seen = [(int(s) + k, p) for p, s in enumerate(starts) for k in range(track_length)]
    return visible(make_scene(num_images, num_points, num_images), seen)


def visible(problem: bundle.Problem, seen) -> bundle.Problem:
    """The problem with the observations (image, point) of a list only."""
    wanted = set(seen)
    pairs = zip(problem.observation_image, problem.observation_point, strict=True)
    keep = np.array([(int(i), int(p)) in wanted for i, p in pairs])
    return problem.replace(
        observation_image=problem.observation_image[keep],
        observation_point=problem.observation_point[keep],
        observation_xy=problem.observation_xy[keep],
        observation_keypoint=problem.observation_keypoint[keep],
    )
