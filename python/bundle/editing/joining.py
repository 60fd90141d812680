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
from bundle.model.colmap.model_records import NO_POINT, ModelRecords
from bundle.model.colmap.source_records import CAMERA, Sensor, frame_of_image, is_trivial

FEWEST = 2  # minimum observations left of a point of B that meets points of A but agrees with none

_Indices = NDArray[np.int64]


@dataclass
class Joined:
    """Numbers of images, cameras, points and observations of B by outcome."""

    num_images: int = 0  # images that were added to A
    num_cameras: int = 0  # cameras that were added to A
    num_points_added: int = 0  # points of B without a meeting
    num_points_joined: int = 0  # points of B whose tracks extend tracks of A
    # points of B that were added although they meet points of A, because they agree with none of
    # them
    num_points_apart: int = 0
    num_points_dropped: int = 0  # points of B with fewer than two observations left
    num_observations: int = 0  # observations that were added
    # observations of B that were not added: observations at keypoints of A's points, in images that
    # the track already has, and of dropped points
    num_observations_dropped: int = 0


def join(
    a: ModelRecords,
    b: ModelRecords,
    images: AddedImages,
    keypoints: SharedKeypoints,
    meetings: Meetings,
    agree: NDArray[np.bool_],
) -> tuple[ModelRecords, Joined]:
    """Return the records of A with those of B, and the new place of each record of B.

    Args:
        b: records of model B, in the coordinate frame of A.
        keypoints: keypoints that B observes in shared images.
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
    point_ids = np.concatenate(
        [a.point_ids, _free_ids(b.point_ids[is_new], a.point_ids, b.point_ids)]
    )
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
    """Return A with B's images and keypoints, and the new row of each keypoint of B.

    In a shared image, keypoints that only B has follow those of A. A keypoint that is not moved to
    A has the row -1.
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


# Images of model B that model A lacks, with their cameras, and the rigs and frames that they need.
#
# An image of B keeps its id if A does not use it, and so does a camera; others get ids above all
# ids of both models. Every added image has a frame of its own. Its camera has a rig of its own: the
# rig with the smallest id of which it is the only camera, or a new rig.


@dataclass(frozen=True, kw_only=True)
class AddedImages:
    """Shared images of A and B, and those that B adds. Positions are those in the records."""

    shared: _Indices  # (n, 2) positions in A and in B of each shared image
    added: _Indices  # (num_added,) positions in B, by id; they follow A's images
    image_ids: _Indices  # (num_added,) new ids
    image_camera_ids: _Indices  # (num_added,) ids of their cameras in the merged model
    camera_rows: _Indices  # rows in B of the added cameras
    camera_ids: _Indices  # new ids of the added cameras
    place_of_b: _Indices  # (num_images of B,) position of each image of B in the merged model

    def with_images(self, a: ModelRecords, b: ModelRecords) -> ModelRecords:
        """Return the records of A with the images of B; keypoints are those of A."""
        cameras = np.append(a.camera_ids, self.camera_ids)
        by_id = np.argsort(cameras)
        models = [*a.camera_models, *(b.camera_models[row] for row in self.camera_rows)]
        rigs, frames = self._rigs_and_frames(a, b)
        return dataclasses.replace(
            a,
            camera_ids=cameras[by_id],
            camera_models=tuple(models[row] for row in by_id),
            camera_sizes=np.concatenate([a.camera_sizes, b.camera_sizes[self.camera_rows]])[by_id],
            camera_params=_stacked(a.camera_params, b.camera_params[self.camera_rows])[by_id],
            rigs=sorted(rigs.items()),
            frames=[frames[frame_id] for frame_id in sorted(frames)],
            image_ids=np.append(a.image_ids, self.image_ids),
            image_names=(*a.image_names, *(b.image_names[row] for row in self.added)),
            image_camera_ids=np.append(a.image_camera_ids, self.image_camera_ids),
            cam_from_world=np.concatenate([a.cam_from_world, b.cam_from_world[self.added]]),
        )

    def _rigs_and_frames(
        self, a: ModelRecords, b: ModelRecords
    ) -> tuple[dict[int, list[Sensor]], dict[int, tuple[int, *tuple[object, ...]]]]:
        rigs = dict(a.rigs)
        frames = {int(frame[0]): frame for frame in a.frames}
        rig_of: dict[int, int] = {}
        for rig_id, sensors in sorted(rigs.items()):
            if sensors and sensors[0].type == CAMERA and is_trivial(sensors):
                rig_of.setdefault(sensors[0].id, rig_id)
        last_frame = max(frames, default=0)
        poses = b.cam_from_world[self.added].tolist()
        for image_id, camera_id, pose in zip(
            self.image_ids.tolist(), self.image_camera_ids.tolist(), poses, strict=True
        ):
            if camera_id not in rig_of:
                rig_of[camera_id] = camera_id if camera_id not in rigs else max(rigs) + 1
                rigs[rig_of[camera_id]] = [Sensor(CAMERA, camera_id)]
            frame_id = image_id if image_id not in frames else last_frame + 1
            last_frame = max(last_frame, frame_id)
            frame = frame_of_image(rig_of[camera_id], image_id, camera_id, tuple(pose))
            frames[frame_id] = (frame_id, frame.rig_id, frame.pose, frame.data)
        return rigs, frames


def added_images(
    a: ModelRecords, b: ModelRecords, shared: _Indices, cameras: dict[int, int]
) -> AddedImages:
    """Return the images that B adds to A.

    ``shared``: (n, 2) positions in A and in B of each shared image. ``cameras``: table from cameras
    of B to cameras of A that replace them.
    """
    others = np.setdiff1d(np.arange(len(b.image_ids)), shared[:, 1])
    added = others[np.argsort(b.image_ids[others])]
    needed = list(dict.fromkeys(b.image_camera_ids[added].tolist()))
    new = np.array([camera for camera in needed if camera not in cameras], np.int64)
    new_ids = _free_ids(new, a.camera_ids, b.camera_ids)
    table = {**cameras, **dict(zip(new.tolist(), new_ids.tolist(), strict=True))}
    place = np.empty(len(b.image_ids), np.int64)
    place[shared[:, 1]] = shared[:, 0]
    place[added] = len(a.image_ids) + np.arange(len(added))
    return AddedImages(
        shared=shared,
        added=added,
        image_ids=_free_ids(b.image_ids[added], a.image_ids, b.image_ids),
        image_camera_ids=np.array(
            [table[camera] for camera in b.image_camera_ids[added].tolist()], np.int64
        ),
        camera_rows=np.searchsorted(b.camera_ids, new),
        camera_ids=new_ids,
        place_of_b=place,
    )


def _free_ids(ids: _Indices, taken: _Indices, others: _Indices) -> _Indices:
    """Return ids that are not taken; ids that are get new ones above all."""
    is_taken = np.isin(ids, taken)
    spare = max(taken.max(initial=0), others.max(initial=0))
    free = ids.copy()
    free[is_taken] = spare + 1 + np.arange(int(is_taken.sum()))
    return free


def _stacked(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rows of both, padded with zeros to the larger width."""
    width = max(a.shape[1], b.shape[1])
    return np.concatenate([np.pad(rows, ((0, 0), (0, width - rows.shape[1]))) for rows in (a, b)])


# Shared images of two models: common keypoints, and the points that meet at them.
#
# In models from the same database, keypoint indices agree. If a model was written with observed
# keypoints only, indices differ but coordinates agree. Coordinates that several keypoints of A
# share are ambiguous and ignored.

SAME_KEYPOINT = 0.01
"""Largest difference in x and y, in pixels, of keypoints with the same index: single precision and
text files round coordinates."""


@dataclass(frozen=True)
class Meetings:
    """Pairs of points of A and B that are observed at the same keypoint of a shared image."""

    # (num_pairs,) row of the point in A; the pairs are sorted by the row in B, then A
    point_a: _Indices
    point_b: _Indices  # (num_pairs,) row of the point in B
    count: _Indices  # (num_pairs,) number of shared keypoints of each pair


@dataclass(frozen=True)
class SharedKeypoints:
    """Keypoints that B observes in shared images, as rows among all keypoints of the records."""

    image: _Indices  # (n,) index of the shared image, in the caller's order
    row_a: _Indices  # (n,) row among the keypoints of A; -1 if A's image lacks the keypoint
    row_b: _Indices  # (n,) row among the keypoints of B

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
    """Return A's keypoints that correspond to those that B observes in shared images.

    ``b``: records of the second model. ``images``: (n, 2) positions in A's and B's records of each
    shared image.
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
