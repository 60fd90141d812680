"""Joining of model B to model A, in the same coordinate frame: images, cameras, points.

Ids, poses, cameras and points of A stay unchanged. B's ids are kept if A does not use them. Two
points meet if they have observations at the same keypoint of a shared image. An observation of B is
free if A has no point at its keypoint.

* A point of B that meets no point of A becomes a new point.
* A point that meets points of A is joined to an agreeing point of A: the point with most meetings,
  on a tie the point with the smallest id. Its free observations in images that A's track lacks are
  added to A's track. If several of B's points have such an observation in one image, the point with
  the smallest id adds its own.
* A point that meets points of A but agrees with none of them becomes a new point with its free
  observations. The others stay with A's points. It is dropped if fewer than two are left.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.editing.merging.joined_images import AddedImages
from bundle.editing.merging.shared_keypoints import Meetings, SharedKeypoints
from bundle.model.colmap.model_records import NO_POINT, ModelRecords

FEWEST = 2
"""Minimum observations left of a point of B that meets points of A but agrees with none."""

_Indices = NDArray[np.int64]


@dataclass
class Joined:
    """Numbers of images, cameras, points and observations of B by outcome.

    Attributes:
        num_images: images that were added to A.
        num_cameras: cameras that were added to A.
        num_points_added: points of B without a meeting.
        num_points_joined: points of B whose tracks extend tracks of A.
        num_points_apart: points of B that were added although they meet points of A, because they
            agree with none of them.
        num_points_dropped: points of B with fewer than two observations left.
        num_observations: observations that were added.
        num_observations_dropped: observations of B that were not added: observations at keypoints
            of A's points, in images that the track already has, and of dropped points.
    """

    num_images: int = 0
    num_cameras: int = 0
    num_points_added: int = 0
    num_points_joined: int = 0
    num_points_apart: int = 0
    num_points_dropped: int = 0
    num_observations: int = 0
    num_observations_dropped: int = 0


def join(
    a: ModelRecords,
    b: ModelRecords,
    images: AddedImages,
    keypoints: SharedKeypoints,
    meetings: Meetings,
    agree: NDArray[np.bool_],
) -> tuple[ModelRecords, Joined]:
    """Return the records of A with those of B, and what became of B's.

    Args:
        a: records of model A.
        b: records of model B, in the coordinate frame of A.
        images: shared and added images.
        keypoints: keypoints that B observes in shared images.
        meetings: pairs of points that meet.
        agree: (num_pairs,) True for pairs that are the same point.
    """
    merged, place = _with_keypoints(a, b, images, keypoints)
    first = np.cumsum(merged.num_keypoints) - merged.num_keypoints
    first_b = np.cumsum(b.num_keypoints) - b.num_keypoints
    # Elements of B's tracks, sorted by the id of their point: its row, image and keypoint.
    row = np.repeat(np.arange(len(b.point_ids)), b.track_lengths)
    at = place[first_b[b.track_images] + b.track_keypoints]
    image = images.place_of_b[b.track_images]
    is_free = merged.keypoint_points[at] == NO_POINT

    chosen, num_met = _chosen(meetings, agree, len(b.point_ids))
    is_met = np.bincount(meetings.point_b, minlength=len(b.point_ids)) > 0
    is_joined = chosen >= 0
    num_free = np.bincount(row[is_free], minlength=len(b.point_ids))
    is_dropped = ~is_joined & is_met & (num_free < FEWEST)
    is_new = ~is_joined & ~is_dropped

    continued = _continuing(a, len(first), chosen, row, image, is_free & is_joined[row])
    started = np.flatnonzero(is_free & is_new[row])
    new_row = len(a.point_ids) + np.cumsum(is_new) - 1
    point = np.concatenate(
        [
            np.repeat(np.arange(len(a.point_ids)), a.track_lengths),
            chosen[row[continued]],
            new_row[row[started]],
        ]
    )
    added = np.concatenate([continued, started])
    counts = Joined(
        num_images=len(images.added),
        num_cameras=len(images.camera_rows),
        num_points_added=int((is_new & ~is_met).sum()),
        num_points_joined=int(is_joined.sum()),
        num_points_apart=int((is_new & is_met).sum()),
        num_points_dropped=int(is_dropped.sum()),
        num_observations=len(added),
        # A's point already has the observations where it meets the joined point.
        num_observations_dropped=len(row) - len(added) - int(num_met[is_joined].sum()),
    )
    point_ids = np.concatenate([a.point_ids, _new_ids(a.point_ids, b.point_ids, is_new)])
    by_id = np.argsort(point_ids)
    rank = np.argsort(by_id)
    in_order = np.argsort(rank[point], kind="stable")
    merged.keypoint_points[at[added]] = point_ids[point[len(a.track_images) :]]
    return dataclasses.replace(
        merged,
        point_ids=point_ids[by_id],
        points=np.concatenate([a.points, b.points[is_new]])[by_id],
        point_colors=np.concatenate([a.point_colors, b.point_colors[is_new]])[by_id],
        track_lengths=np.bincount(rank[point], minlength=len(point_ids)),
        track_images=np.concatenate([a.track_images, image[added]])[in_order],
        track_keypoints=np.concatenate([a.track_keypoints, at[added] - first[image[added]]])[
            in_order
        ],
    ), counts


def _with_keypoints(
    a: ModelRecords, b: ModelRecords, images: AddedImages, shared: SharedKeypoints
) -> tuple[ModelRecords, _Indices]:
    """Return A with B's images and keypoints, and the row there of each keypoint of B.

    Keypoints that a shared image has in B only follow those of A. The row of a keypoint that stays
    in B is -1.
    """
    missing = np.flatnonzero(shared.row_a < 0)
    image = images.shared[shared.image[missing], 0]  # ascending within an image
    order = np.argsort(image, kind="stable")
    missing, image = missing[order], image[order]
    appended = np.bincount(image, minlength=len(a.image_ids))
    total = np.concatenate([a.num_keypoints + appended, b.num_keypoints[images.added]])
    first = np.cumsum(total) - total
    first_a, first_b = (np.cumsum(r.num_keypoints) - r.num_keypoints for r in (a, b))

    place_a = _ranges(first[: len(first_a)], a.num_keypoints)
    place = np.full(len(b.keypoint_xy), -1)
    there = shared.row_a >= 0
    place[shared.row_b[there]] = place_a[shared.row_a[there]]
    place[shared.row_b[missing]] = _ranges(first[: len(first_a)] + a.num_keypoints, appended)
    size = b.num_keypoints[images.added]
    place[_ranges(first_b[images.added], size)] = _ranges(first[len(first_a) :], size)

    xy = np.empty((int(total.sum()), 2))
    xy[place[place >= 0]] = b.keypoint_xy[place >= 0]
    xy[place_a] = a.keypoint_xy
    points = np.full(len(xy), NO_POINT)
    points[place_a] = a.keypoint_points
    records = images.with_images(a, b)
    return dataclasses.replace(
        records, num_keypoints=total, keypoint_xy=xy, keypoint_points=points
    ), place


def _ranges(begin: _Indices, size: _Indices) -> _Indices:
    """Return the concatenation of ``arange(begin, begin + size)`` of all rows."""
    ends = np.cumsum(size)
    total = int(ends[-1]) if len(ends) else 0
    return np.arange(total) + np.repeat(begin - ends + size, size)


def _chosen(
    meetings: Meetings, agree: NDArray[np.bool_], num_points_b: int
) -> tuple[_Indices, _Indices]:
    """Return, for each point of B, the row of the point of A that it joins, and their meetings.

    The row is -1 for a point that joins no point.
    """
    pairs = np.flatnonzero(agree)
    # Sorted by point of B, then count, then point of A from the end: the last assignment remains.
    order = np.lexsort((-meetings.point_a[pairs], meetings.count[pairs]))
    chosen, count = np.full(num_points_b, -1), np.zeros(num_points_b, np.int64)
    for value, source in ((chosen, meetings.point_a), (count, meetings.count)):
        value[meetings.point_b[pairs[order]]] = source[pairs[order]]
    return chosen, count


def _continuing(
    a: ModelRecords,
    num_images: int,
    chosen: _Indices,
    row: _Indices,
    image: _Indices,
    is_candidate: NDArray[np.bool_],
) -> _Indices:
    """Return the elements of B's tracks that continue A's: one per image that A's track lacks."""
    rows_a = np.repeat(np.arange(len(a.point_ids)), a.track_lengths)
    candidates = np.flatnonzero(is_candidate)
    view = chosen[row[candidates]] * num_images + image[candidates]
    candidates = candidates[~np.isin(view, rows_a * num_images + a.track_images)]
    view = chosen[row[candidates]] * num_images + image[candidates]
    _, first = np.unique(view, return_index=True)
    chosen_elements: _Indices = candidates[np.sort(first)]
    return chosen_elements


def _new_ids(ids_a: _Indices, ids_b: _Indices, is_new: NDArray[np.bool_]) -> _Indices:
    """Return the ids of B's new points: their own, or above all others if A uses them."""
    ids = ids_b[is_new]
    taken = np.isin(ids, ids_a)
    spare = max(ids_a.max(initial=0), ids_b.max(initial=0))
    ids[taken] = spare + 1 + np.arange(int(taken.sum()))
    return ids
