"""Source records that a problem lacks: rigs, frames, keypoints, colours, tracks.

COLMAP puts every image into a frame of a rig. The sensors of a rig are cameras and IMUs. The first
sensor is the reference sensor. The data of a frame list its images (for cameras).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass

CAMERA = 0
"""Sensor type of a camera; 1 is an IMU."""

Pose = tuple[float, ...]
"""Pose qx qy qz qw tx ty tz."""


_ORIGIN = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class Sensor(NamedTuple):
    """A sensor of a rig.

    Attributes:
        type: CAMERA, or 1 for an IMU.
        id: id of the camera or IMU.
        pose: sensor_from_rig; None if unknown, and for the reference sensor.
    """

    type: int
    id: int
    pose: Pose | None = None


class Datum(NamedTuple):
    """A measurement of a sensor; for a camera, ``id`` is the id of the image."""

    type: int
    sensor_id: int
    id: int


class Frame(NamedTuple):
    """A rig at one time; ``pose`` is rig_from_world, None if unknown."""

    rig_id: int
    pose: Pose | None
    data: tuple[Datum, ...]

    @property
    def image_ids(self) -> list[int]:
        """Ids of the images of the frame."""
        return [datum.id for datum in self.data if datum.type == CAMERA]


@dataclass(frozen=True, kw_only=True)
class Contents:
    """Keypoints, colours and tracks.

    Attributes:
        keypoint_xy: (num_keypoints, 2) coordinates, image by image in the order of
            ``SourceRecords.image_ids``.
        point_ids: (num_points,) ids of the points, in any order.
        point_colors: (num_points, 3) red, green, blue.
        track_lengths: (num_points,) number of elements of each track.
        track_image_ids: (num_elements,) image id of each element, track by track.
        track_keypoints: (num_elements,) index among the keypoints of the image.
    """

    keypoint_xy: NDArray[np.float64]
    point_ids: NDArray[np.int64]
    point_colors: NDArray[np.uint8]
    track_lengths: NDArray[np.int64]
    track_image_ids: NDArray[np.int64]
    track_keypoints: NDArray[np.int64]


def _no_contents() -> Contents:
    none = np.empty(0, np.int64)
    return Contents(
        keypoint_xy=np.empty((0, 2)),
        point_ids=none,
        point_colors=np.empty((0, 3), np.uint8),
        track_lengths=none,
        track_image_ids=none,
        track_keypoints=none,
    )


@dataclass(frozen=True, kw_only=True)
class SourceRecords:
    """A COLMAP model; empty for the source of a problem from memory or from a BAL file.

    Attributes:
        rigs: sensors by rig id.
        frames: frames by id, in the order of registration, which is the order of images in files.
        image_ids: (num_images,) ids of the images, in any order.
        image_camera_ids: (num_images,) camera id of each image.
        num_keypoints: (num_images,) number of keypoints of each image.
        contents: function that reads keypoints, colours and tracks; slow for large models.
    """

    rigs: dict[int, list[Sensor]] = field(default_factory=dict)
    frames: dict[int, Frame] = field(default_factory=dict)
    image_ids: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    image_camera_ids: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    num_keypoints: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    contents: Callable[[], Contents] = _no_contents


def records_of_model(model: _core.ColmapModel) -> SourceRecords:
    """Return the records of a model that was read.

    A model without rigs and frames gets those that COLMAP would create: a rig for each camera and a
    frame for each image, with the same ids.
    """
    views: dict[str, Any] = _core.colmap_views(model)
    rigs = {rig_id: [Sensor(*sensor) for sensor in sensors] for rig_id, sensors in views["rigs"]}
    frames = {
        frame_id: Frame(rig_id, tuple(pose), tuple(Datum(*datum) for datum in data))
        for frame_id, rig_id, pose, data in views["frames"]
    }
    if not rigs and not frames:
        rigs = {camera_id: [Sensor(CAMERA, camera_id)] for camera_id in views["camera_ids"]}
        for image_id, camera_id in zip(
            views["image_ids"].tolist(), views["image_camera_ids"].tolist(), strict=True
        ):
            frames[image_id] = frame_of_image(camera_id, image_id, camera_id, _ORIGIN)
    return SourceRecords(
        rigs=rigs,
        frames=frames,
        image_ids=views["image_ids"],
        image_camera_ids=views["image_camera_ids"],
        num_keypoints=views["num_keypoints"],
        contents=lambda: Contents(**_core.colmap_contents(model)),
    )


def frame_of_image(rig_id: int, image_id: int, camera_id: int, pose: Pose) -> Frame:
    """Return a frame with one image."""
    return Frame(rig_id, pose, (Datum(CAMERA, camera_id, image_id),))


def is_trivial(sensors: list[Sensor]) -> bool:
    """Return True if the only camera of a rig is its reference sensor."""
    return all(sensor.type != CAMERA for sensor in sensors[1:])
