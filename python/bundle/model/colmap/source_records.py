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
from bundle.base.arrays import refuse_row
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.model.problem_arrays import ProblemArrays

CAMERA = 0  # sensor type of a camera; 1 is an IMU

Pose = tuple[float, ...]
"""Pose qx qy qz qw tx ty tz."""


_ORIGIN = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class Sensor(NamedTuple):
    """A sensor of a rig."""

    type: int  # CAMERA, or 1 for an IMU
    id: int  # id of the camera or IMU
    pose: Pose | None = None  # sensor_from_rig; None if unknown, and for the reference sensor


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
    """Keypoints, colours and tracks."""

    # (num_keypoints, 2) coordinates, image by image in the order of ``SourceRecords.image_ids``
    keypoint_xy: NDArray[np.float64]
    point_ids: NDArray[np.int64]  # (num_points,) ids of the points, in any order
    point_colors: NDArray[np.uint8]  # (num_points, 3) red, green, blue
    track_lengths: NDArray[np.int64]  # (num_points,) number of elements of each track
    track_image_ids: NDArray[np.int64]  # (num_elements,) image id of each element, track by track
    track_keypoints: NDArray[np.int64]  # (num_elements,) index among the keypoints of the image


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
    """A COLMAP model; empty for the source of a problem from memory or from a BAL file."""

    rigs: dict[int, list[Sensor]] = field(default_factory=dict)  # sensors by rig id
    # frames by id, in the order of registration, which is the order of images in files
    frames: dict[int, Frame] = field(default_factory=dict)
    # (num_images,) ids of the images, in any order
    image_ids: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    # (num_images,) camera id of each image
    image_camera_ids: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    # (num_images,) number of keypoints of each image
    num_keypoints: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    # function that reads keypoints, colours and tracks; slow for large models
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


# Indices of the observations of a problem among the keypoints of a COLMAP model.
#
# COLMAP identifies an observation by image and keypoint. Keypoints of source images keep their
# indices, because databases and descriptors refer to them. An observation without an index becomes
# a new keypoint after them. Images that the source does not have contain only observed keypoints.

_Indices = NDArray[np.int64]


@dataclass(frozen=True)
class KeypointNumbers:
    """Keypoints of the observations of a problem."""

    keypoint: _Indices  # (num_observations,) index of each observation in its image
    # (num_images,) number of keypoints of each image, including new keypoints
    num_keypoints: _Indices
    num_renumbered: int  # number of observations with another index than in the problem


def number_keypoints(problem: ProblemArrays, num_keypoints: _Indices) -> KeypointNumbers:
    """Number the keypoints of a problem.

    ``num_keypoints``: (num_images,) number of keypoints of each image in the source; -1 for an
    image that is not in the source.
    """
    capacity = num_keypoints[problem.observation_image]
    given = problem.observation_keypoint >= 0
    refuse_row(
        (capacity >= 0) & (problem.observation_keypoint >= capacity),
        lambda bad: (
            f"observation_keypoint: observation {bad}: expected one of the {capacity[bad]} "
            f"keypoints that image {problem.image_ids[problem.observation_image[bad]]} has in the "
            f"source, or -1 for a new keypoint, found {problem.observation_keypoint[bad]}"
        ),
    )
    _check_once(problem, np.flatnonzero(given))
    is_new = ~given | (capacity < 0)
    added = np.bincount(problem.observation_image[is_new], minlength=problem.num_images)
    keypoint = problem.observation_keypoint.astype(np.int64)
    keypoint[is_new] = _numbered(problem, np.flatnonzero(is_new), added, np.maximum(capacity, 0))
    return KeypointNumbers(
        keypoint=keypoint,
        num_keypoints=np.maximum(num_keypoints, 0) + added,
        num_renumbered=int((given & (keypoint != problem.observation_keypoint)).sum()),
    )


def _check_once(problem: ProblemArrays, given: _Indices) -> None:
    """Check that the given observations have different keypoints."""
    image = problem.observation_image[given].astype(np.int64)
    keys = image << 32 | problem.observation_keypoint[given]
    order = np.argsort(keys, kind="stable")
    twice = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    if len(twice):
        first, second = given[order[twice[0]]], given[order[twice[0] + 1]]
        raise InputError(
            f"observation_keypoint: observations {first} and {second}: expected each keypoint of "
            f"an image once, found keypoint {problem.observation_keypoint[first]} of image "
            f"{problem.image_ids[problem.observation_image[first]]} twice"
        )


def _numbered(
    problem: ProblemArrays, new: _Indices, added: _Indices, capacity: _Indices
) -> _Indices:
    """Return the indices of new keypoints: after those of the source, without gaps.

    In each image, observations with an index come first, in the order of their indices. The other
    observations follow in the order of the problem.
    """
    keypoint = problem.observation_keypoint[new].astype(np.int64)
    keypoint[keypoint < 0] = np.iinfo(np.int64).max
    order = np.lexsort((keypoint, problem.observation_image[new]))
    begins = np.repeat(np.cumsum(added) - added, added)
    numbers = np.empty(len(new), np.int64)
    numbers[order] = np.arange(len(new)) - begins
    return numbers + capacity[new]
