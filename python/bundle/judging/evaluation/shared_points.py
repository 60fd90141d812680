"""Points of two models that belong to the same track, found by common keypoints of shared images.

Two observations in a shared image are the same measurement if they have the same keypoint index and
pixels that differ by at most 0.01 (models of one database), or else exactly the same pixel. A pixel
that several observations of an image have is ambiguous and is ignored. Each common measurement
is a vote for its pair of points. A pair counts if each of its points has its most votes with the
other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.georeference.similarity import Similarity
from bundle.model.pose_table import ErrorStatistics
from bundle.model.problem import Problem

SAME_KEYPOINT = 0.01
"""Largest difference in x and y, in pixels, of keypoints with the same index."""

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class PointDifference:
    """Distances of shared points after the alignment."""

    num_shared: int  # number of pairs
    num_a: int  # number of points of A
    num_b: int  # number of points of B
    distance: ErrorStatistics  # statistics of the distances in length units of B
    percentile_90: float  # distance that 90 % of the pairs do not exceed


def point_difference(
    a: Problem, b: Problem, pairs: Indices, similarity: Similarity
) -> PointDifference:
    """Return the distances of pairs (n, 2) of indices of points, with A moved by a similarity."""
    gap = similarity.apply(a.points[pairs[:, 0]]) - b.points[pairs[:, 1]]
    distance = np.linalg.norm(gap, axis=1)
    return PointDifference(
        num_shared=len(pairs),
        num_a=a.num_points,
        num_b=b.num_points,
        distance=ErrorStatistics.of(distance),
        percentile_90=float(np.quantile(distance, 0.9)) if len(pairs) else np.nan,
    )


def shared_points(a: Problem, b: Problem, rows_a: Indices, rows_b: Indices) -> Indices:
    """Return (n, 2) indices of points of the same tracks in shared images, in the order of A."""
    first, second = _Views(a, rows_a), _Views(b, rows_b)
    listed_a, listed_b = first.with_keypoint(), second.with_keypoint()
    same_a, same_b = _join(first.keypoint_keys(listed_a), second.keypoint_keys(listed_b))
    same_a, same_b = listed_a[same_a], listed_b[same_b]
    close = np.abs(first.xy[same_a] - second.xy[same_b]).max(axis=1, initial=0) <= SAME_KEYPOINT
    same_a, same_b = same_a[close], same_b[close]
    rest_a, rest_b = first.others(same_a), second.others(same_b)
    labels = _labels(np.vstack([first.pixels(rest_a), second.pixels(rest_b)]))
    more_a, more_b = _join(labels[: len(rest_a)], labels[len(rest_a) :])
    points_a = first.point[np.concatenate([same_a, rest_a[more_a]])]
    points_b = second.point[np.concatenate([same_b, rest_b[more_b]])]
    return _mutual(points_a, points_b, b.num_points)


class _Views:
    """Observations of a model in shared images."""

    def __init__(self, problem: Problem, rows: Indices) -> None:
        place = np.full(problem.num_images, -1)
        place[rows] = np.arange(len(rows))
        image = place[problem.observation_image]
        chosen = np.flatnonzero(image >= 0)
        self._image = image[chosen]
        self.xy = problem.observation_xy[chosen]
        self.point = problem.observation_point[chosen].astype(np.int64)
        self._keypoint = problem.observation_keypoint[chosen].astype(np.int64)

    def with_keypoint(self) -> Indices:
        """Return the observations that have a keypoint."""
        return np.flatnonzero(self._keypoint >= 0)

    def keypoint_keys(self, rows: Indices) -> Indices:
        """Return a number for image and keypoint of some observations."""
        keys: Indices = (self._image[rows] << 32) | self._keypoint[rows]
        return keys

    def others(self, taken: Indices) -> Indices:
        """Return the observations that are not in a list."""
        mask = np.ones(len(self.xy), dtype=bool)
        mask[taken] = False
        return np.flatnonzero(mask)

    def pixels(self, rows: Indices) -> Array:
        """Return image, x and y of some observations, (n, 3)."""
        return np.column_stack([self._image[rows], self.xy[rows]])


def _labels(table: Array) -> Indices:
    """Return a number for each row of a table (n, 3); equal rows have the same number."""
    order = np.lexsort(table.T)
    is_new = np.any(np.diff(table[order], axis=0) != 0, axis=1)
    labels = np.empty(len(table), np.int64)
    labels[order] = np.concatenate([np.zeros(min(len(table), 1), np.int64), np.cumsum(is_new)])
    return labels


def _join(keys_a: Indices, keys_b: Indices) -> tuple[Indices, Indices]:
    row_a, row_b = _single(keys_a), _single(keys_b)
    _, in_a, in_b = np.intersect1d(
        keys_a[row_a], keys_b[row_b], assume_unique=True, return_indices=True
    )
    return row_a[in_a], row_b[in_b]


def _single(keys: Indices) -> Indices:
    _, first, counts = np.unique(keys, return_index=True, return_counts=True)
    rows: Indices = np.sort(first[counts == 1])
    return rows


def _mutual(points_a: Indices, points_b: Indices, width: int) -> Indices:
    """Return the pairs in which each point has its most votes with the other."""
    keys, votes = np.unique(points_a * max(width, 1) + points_b, return_counts=True)
    pairs = np.column_stack(np.divmod(keys, max(width, 1)))
    order = np.argsort(-votes, kind="stable")
    best = np.ones(len(pairs), dtype=bool)
    for column in range(2):
        _, first = np.unique(pairs[order, column], return_index=True)
        is_first = np.zeros(len(pairs), dtype=bool)
        is_first[order[first]] = True
        best &= is_first
    return pairs[best]
