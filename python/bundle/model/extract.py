"""A problem that consists of some images, cameras, points and observations of another one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.model.problem import Problem

__all__ = ["Extract", "with_frames"]

_Indices = NDArray[np.int64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Extract:
    """A problem, and where its parts are in the one that it was taken from.

    Attributes:
        problem: with the ids of the whole.
        images: indices in the whole, ascending, as all others.
        cameras: likewise.
        points: likewise.
        observations: likewise.
        frames: those of the images.
        sensors: all of the rigs of these frames.
    """

    problem: Problem
    images: _Indices
    cameras: _Indices
    points: _Indices
    observations: _Indices
    frames: _Indices
    sensors: _Indices

    @staticmethod
    def take(
        whole: Problem, *, images: _Mask, cameras: _Mask, points: _Mask, observations: _Mask
    ) -> Extract:
        """Return what the masks select; cameras of the images are among the cameras."""
        of_images, of_cameras = np.flatnonzero(images), np.flatnonzero(cameras)
        of_points, seen = np.flatnonzero(points), np.flatnonzero(observations)
        frames, sensors = _rigs_of(whole, of_images)
        rows = of_images, of_cameras, of_points, seen, frames, sensors
        return Extract(_problem(whole, *rows), *rows)


def with_frames(problem: Problem, images: _Mask) -> _Mask:
    """Return the images, and those that share a frame with one of them."""
    if not problem.num_frames:
        return images
    frames = problem.image_frame[images]
    return images | np.isin(problem.image_frame, frames[frames >= 0])


def _problem(
    whole: Problem,
    images: _Indices,
    cameras: _Indices,
    points: _Indices,
    seen: _Indices,
    frames: _Indices,
    sensors: _Indices,
) -> Problem:
    sigma = whole.observation_sigma
    return Problem(
        cam_from_world=whole.cam_from_world[images],
        image_ids=whole.image_ids[images],
        image_names=tuple(whole.image_names[index] for index in images.tolist()),
        image_camera=_rows(cameras, whole.num_cameras)[whole.image_camera[images]],
        camera_ids=whole.camera_ids[cameras],
        camera_models=tuple(whole.camera_models[index] for index in cameras.tolist()),
        camera_params=whole.camera_params[cameras],
        camera_sizes=whole.camera_sizes[cameras],
        points=whole.points[points],
        point_ids=whole.point_ids[points],
        observation_image=_rows(images, whole.num_images)[whole.observation_image[seen]],
        observation_point=_rows(points, whole.num_points)[whole.observation_point[seen]],
        observation_xy=whole.observation_xy[seen],
        observation_sigma=None if sigma is None else sigma[seen],
        format=whole.format,
        **_rig_arrays(whole, images, frames, sensors),
    )


def _rows(indices: _Indices, count: int) -> NDArray[np.int32]:
    """Return the place of each of ``count`` among the indices, and -1 for -1."""
    rows = np.full(count + 1, -1, np.int32)
    rows[indices] = np.arange(len(indices))
    return rows


def _rigs_of(whole: Problem, images: _Indices) -> tuple[_Indices, _Indices]:
    """Return the frames of images, and the sensors of rigs that have one of them."""
    if not whole.num_frames:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    frames = whole.image_frame[images]
    of_images = np.unique(frames[frames >= 0]).astype(np.int64)
    rigs = whole.frame_rig_ids[of_images]
    return of_images, np.flatnonzero(np.isin(whole.sensor_rig_ids, rigs))


def _rig_arrays(
    whole: Problem, images: _Indices, frames: _Indices, sensors: _Indices
) -> dict[str, Any]:
    if not len(frames):
        return {}
    return {
        "rig_from_world": whole.rig_from_world[frames],
        "frame_ids": whole.frame_ids[frames],
        "frame_rig_ids": whole.frame_rig_ids[frames],
        "image_frame": _rows(frames, whole.num_frames)[whole.image_frame[images]],
        "sensor_from_rig": whole.sensor_from_rig[sensors],
        "sensor_rig_ids": whole.sensor_rig_ids[sensors],
        "sensor_camera_ids": whole.sensor_camera_ids[sensors],
        "image_sensor": _rows(sensors, whole.num_sensors)[whole.image_sensor[images]],
    }
