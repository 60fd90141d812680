"""Shared images of two models: common keypoints, and the points that meet at them.

In models from the same database, keypoint indices agree. If a model was written with observed
keypoints only, indices differ but coordinates agree. Coordinates that several keypoints of A share
are ambiguous and ignored.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.colmap.model_records import NO_POINT, ModelRecords

SAME_KEYPOINT = 0.01
"""Largest difference in x and y, in pixels, of keypoints with the same index: single precision and
text files round coordinates."""

_Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Meetings:
    """Pairs of points of A and B that are observed at the same keypoint of a shared image.

    Attributes:
        point_a: (num_pairs,) row of the point in A; the pairs are sorted by the row in B, then A.
        point_b: (num_pairs,) row of the point in B.
        count: (num_pairs,) number of shared keypoints where they meet.
    """

    point_a: _Indices
    point_b: _Indices
    count: _Indices


@dataclass(frozen=True)
class SharedKeypoints:
    """Keypoints that B observes in shared images, as rows among all keypoints of the records.

    Attributes:
        image: (n,) index of the shared image, in the caller's order.
        row_a: (n,) row among the keypoints of A; -1 if A's image lacks the keypoint.
        row_b: (n,) row among the keypoints of B.
    """

    image: _Indices
    row_a: _Indices
    row_b: _Indices

    def meetings_by_image(self, a: ModelRecords, b: ModelRecords) -> _Indices:
        """Return (m, 3): index of the shared image, row of A's point, row of B's point."""
        here = np.flatnonzero(self.row_a >= 0)
        ids = a.keypoint_points[self.row_a[here]]
        here, ids = here[ids != NO_POINT], ids[ids != NO_POINT]
        point_a = np.searchsorted(a.point_ids, ids.astype(np.int64))
        ids_b = b.keypoint_points[self.row_b[here]].astype(np.int64)
        return np.column_stack([self.image[here], point_a, np.searchsorted(b.point_ids, ids_b)])

    def meetings(self, a: ModelRecords, b: ModelRecords) -> Meetings:
        """Return the pairs of points that meet in any shared image."""
        _, point_a, point_b = self.meetings_by_image(a, b).T
        width = max(len(a.point_ids), 1)
        pairs, count = np.unique(point_b * width + point_a, return_counts=True)
        return Meetings(pairs % width, pairs // width, count)


def shared_keypoints(a: ModelRecords, b: ModelRecords, images: _Indices) -> SharedKeypoints:
    """Return the keypoints of A that are those that B observes in shared images.

    Args:
        a: records of the first model.
        b: records of the second model.
        images: (n, 2) positions in A's and B's records of each shared image.
    """
    first_a, first_b = (np.cumsum(r.num_keypoints) - r.num_keypoints for r in (a, b))
    found = []
    for index, (image_a, image_b) in enumerate(images.tolist()):
        begin_a, begin_b = first_a[image_a], first_b[image_b]
        xy_a = a.keypoint_xy[begin_a : begin_a + a.num_keypoints[image_a]]
        end_b = begin_b + b.num_keypoints[image_b]
        observed = np.flatnonzero(b.keypoint_points[begin_b:end_b] != NO_POINT)
        same = _same_keypoints(xy_a, b.keypoint_xy[begin_b:end_b][observed], observed)
        row_a = np.where(same >= 0, begin_a + same, -1)
        found.append(np.stack([np.full(len(observed), index), row_a, begin_b + observed]))
    return SharedKeypoints(*np.concatenate([np.empty((3, 0), np.int64), *found], axis=1))


def _same_keypoints(
    xy_a: NDArray[np.float64], xy_b: NDArray[np.float64], numbers_b: _Indices
) -> _Indices:
    """Return A's keypoint for each keypoint of B, by index or else by coordinates; -1: missing."""
    found = np.full(len(numbers_b), -1)
    by_index = numbers_b < len(xy_a)
    apart = np.abs(xy_a[numbers_b[by_index]] - xy_b[by_index]).max(axis=1, initial=0)
    by_index[by_index] = apart <= SAME_KEYPOINT
    found[by_index] = numbers_b[by_index]

    others = np.flatnonzero(~by_index)
    places, wanted = xy_a @ [1, 1j], xy_b[others] @ [1, 1j]
    order = np.argsort(places, kind="stable")
    begin, end = (np.searchsorted(places[order], wanted, side) for side in ("left", "right"))
    same = np.where(end - begin == 1, np.append(order, -1)[begin], -1)
    same[np.isin(same, found[by_index])] = -1
    _, first = np.unique(same, return_index=True)  # of several keypoints of B, the first
    found[others[first]] = same[first]
    return found
