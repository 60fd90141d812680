"""Errors of relative poses over all pairs of images and their recall (AUC); shared points.

Of images i and j, with rotations R world_from_camera and centres c, the relative pose in the camera
of j is R_j^T R_i and R_j^T (c_i - c_j). Its errors are

    RRE: the angle between the rotations of estimate and reference,
    RTE: the angle between the directions of the translations,

which no similarity of the world changes: pairs need no alignment. The error e of a pair is the
larger of both. With r(x) the share of pairs with e <= x, all literature reports

    AUC(tau) = 1 / tau * integral of r(x) dx from 0 to tau,

but computes it in four ways (docs/evaluate.md).

The trapezoid needs no sorted errors: between the sorted errors e_k and e_k+1, linear interpolation
adds (e_k+1 - e_k) / (2 n) to the area under the steps. The sum telescopes, so that

    AUC_trapezoid(tau) = AUC_integral(tau) + max{e : e <= tau} / (2 n tau).

All definitions are therefore sums over pairs. They are accumulated over blocks of rows, in memory
that does not grow with the number of pairs. If there are more than 5,000 images, 5,000 of them,
evenly spaced in their order, are used.

RTE depends on the direction of a pair, because the camera that measures it changes; with i < j the
order of the images matters. Callers sort images by name or time. If the cameras of a pair have the
same centre in the reference, no direction exists, and RTE is 0; if they have it in the estimate
only, RTE is 180 degrees.

With g_i = r_i q_i^-1 for the unit quaternions r_i of the reference and q_i of the estimate, RRE is
the angle of g_j^-1 g_i, which is 4 asin(|g_i - g_j| / 2) after a choice of signs, accurate near 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.georeference.similarity import Similarity
from bundle.model.pose_table import ErrorStatistics
from bundle.model.problem import Problem
from bundle.model.rigid_motions import quaternion_inverse, quaternion_multiply, rotation_matrices

Array = NDArray[np.float64]

THRESHOLDS = (1, 3, 5, 10, 30)  # thresholds of AUC, RRA and RTA in degrees

SAME_PLACE = 1e-9  # baseline relative to the extent of the centres below which it has no direction

MOST_IMAGES = 5000  # number of images whose pairs are computed

BLOCK = 100_000  # pairs that are computed at once

Table = dict[str, float]


@dataclass(frozen=True)
class PairErrors:
    """Accuracy of relative poses; tables have the thresholds in degrees as text, such as "5"."""

    num_pairs: int  # number of pairs i < j
    num_pairs_at_one_place: int  # pairs whose cameras have the same centre in the reference
    rotation_accuracy: Table  # RRA, share of pairs with a smaller RRE
    translation_accuracy: Table  # RTA, share of pairs with a smaller RTE
    auc: dict[str, Table]  # AUC by definition, then by threshold


class _Sums:
    """Sums over the errors of pairs."""

    def __init__(self) -> None:
        self.count = 0
        self.area = np.zeros(len(THRESHOLDS))
        self.largest = np.zeros(len(THRESHOLDS))
        self.below = np.zeros(max(THRESHOLDS) + 1)
        self.within = np.zeros(len(THRESHOLDS))

    def add(self, errors: Array) -> None:
        self.count += len(errors)
        near = errors[errors <= max(THRESHOLDS)]
        for k, limit in enumerate(THRESHOLDS):
            inside = near[near <= limit]
            if len(inside):
                self.area[k] += (1 - inside / limit).sum()
                self.largest[k] = max(self.largest[k], inside.max())
                self.within[k] += len(inside)
        self.below[1:] += np.cumsum(np.histogram(near, np.arange(max(THRESHOLDS) + 1))[0])

    def integral(self) -> Array:
        share: Array = self.area / max(self.count, 1)
        return share

    def trapezoid(self, missing: int = 0) -> Array:
        """Return the AUC of the trapezoid, with errors of 180 degrees for missing pairs."""
        count = max(self.count + missing, 1)
        area: Array = self.area / count + self.largest / (2 * count * np.array(THRESHOLDS))
        return area

    def histogram(self) -> Array:
        values = []
        for limit, within in zip(THRESHOLDS, self.within, strict=True):
            # The last bin of a histogram includes its upper edge.
            values.append((self.below[1:limit].sum() + within) / (limit * max(self.count, 1)))
        return np.array(values)


def pair_errors(estimate: Array, reference: Array, num_missing: int = 0) -> PairErrors:
    """Return the accuracy of relative poses over all pairs.

    Both have (n, 7) poses world_from_camera in any world, in the order of names or times. The
    estimate lacks ``num_missing`` further images of the reference.
    """
    if len(reference) > MOST_IMAGES:
        chosen = np.linspace(0, len(reference) - 1, MOST_IMAGES).round().astype(np.int64)
        num_missing = round(num_missing * MOST_IMAGES / len(reference))
        estimate, reference = estimate[chosen], reference[chosen]
    count = len(reference)
    turn = quaternion_multiply(reference[:, :4], quaternion_inverse(estimate[:, :4]))
    matrices = rotation_matrices(turn)
    here, there = _normalized(estimate[:, 4:]), _normalized(reference[:, 4:])
    forward, ordered = _Sums(), _Sums()
    rotation, translation = np.zeros(len(THRESHOLDS)), np.zeros(len(THRESHOLDS))
    at_one_place = 0
    step = max(BLOCK // max(count, 1), 1)
    for begin in range(0, count, step):
        rows = np.arange(begin, min(begin + step, count))
        angle = _rotation_errors(turn, rows)
        direction, alone = _direction_errors(here, there, matrices, rows)
        error = np.maximum(angle, direction)
        later = np.arange(count) > rows[:, None]
        ordered.add(error[np.arange(count) != rows[:, None]])
        forward.add(error[later])
        at_one_place += int((alone & later).sum())
        for k, limit in enumerate(THRESHOLDS):
            rotation[k] += (angle[later] < limit).sum()
            translation[k] += (direction[later] < limit).sum()
    whole = count + num_missing
    missing = whole * (whole - 1) - count * (count - 1)
    pairs = max(forward.count, 1)
    return PairErrors(
        num_pairs=forward.count,
        num_pairs_at_one_place=at_one_place,
        rotation_accuracy=_table(rotation / pairs),
        translation_accuracy=_table(translation / pairs),
        auc={
            "trapezoid": _table(forward.trapezoid()),
            "colmap": _table(ordered.trapezoid(missing)),
            "histogram": _table(forward.histogram()),
            "integral": _table(forward.integral()),
        },
    )


def _rotation_errors(turn: Array, rows: NDArray[np.int64]) -> Array:
    """Return RRE in degrees, (rows, n)."""
    both = [((turn[rows, None] + sign * turn) ** 2).sum(axis=-1) for sign in (-1.0, 1.0)]
    half = np.sqrt(np.minimum(*both)) / 2
    errors: Array = np.degrees(4 * np.arcsin(np.minimum(half, np.sqrt(0.5))))
    return errors


def _direction_errors(
    estimate: Array, reference: Array, matrices: Array, rows: NDArray[np.int64]
) -> tuple[Array, NDArray[np.bool_]]:
    """Return RTE in degrees, (rows, n), and the mask of pairs at one place in the reference."""
    here = estimate[rows, None] - estimate
    there = reference[rows, None] - reference
    turned = np.matmul(matrices, here[..., None])[..., 0]
    cross = np.linalg.norm(np.cross(turned, there), axis=-1)
    angle = np.degrees(np.arctan2(cross, (turned * there).sum(axis=-1)))
    short, alone = (np.linalg.norm(base, axis=-1) <= SAME_PLACE for base in (here, there))
    return np.where(alone, 0.0, np.where(short, 180.0, angle)), alone


def _normalized(centers: Array) -> Array:
    centered = centers - centers.mean(axis=0)
    extent = float(np.abs(centered).max())
    normalized: Array = centered / extent if extent > 0 else centered
    return normalized


def _table(values: Array) -> Table:
    return {
        str(limit): float(value) for limit, value in zip(THRESHOLDS, values.tolist(), strict=True)
    }


# Points of two models that belong to the same track, found by common keypoints of shared images.
#
# Two observations in a shared image are the same measurement if they have the same keypoint index
# and pixels that differ by at most 0.01 (models of one database), or else exactly the same pixel. A
# pixel that several observations of an image have is ambiguous and is ignored. Each common
# measurement is a vote for its pair of points. A pair counts if each of its points has its most
# votes with the other.


SAME_KEYPOINT = 0.01  # largest difference in x and y, in pixels, of keypoints with the same index

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
        """Return one key per observation that identifies its image and keypoint."""
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
