"""Rigs of several sensors: poses of their images, defaults and checks of their arrays.

A frame is a rig at one time. An image of sensor s in frame f has the pose

    cam_from_world = sensor_from_rig[s] * rig_from_world[f],    R = R_s R_f,  t = R_s t_f + t_s,

and an image of the rig's reference sensor has the pose rig_from_world. The pose of such an image is
therefore not an independent variable: to change it, change the pose of its frame or its sensor.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import (
    Array,
    Index,
    check_shape,
    declare,
    distinct,
    filled,
    freeze,
    refuse_row,
)
from bundle.errors import InputError
from bundle.model.problem_arrays import ProblemArrays
from bundle.model.rigid_motions import inverse_poses, multiply_poses, rotation_matrices, unit_poses

_Poses = NDArray[np.float64]
_Rows = NDArray[np.int32]

ARRAYS = declare(
    rig_from_world=Array(("num_frames", 7), "pose", default=0),
    frame_ids=Array(("num_frames",), dtype=np.int64, default="range"),
    image_frame=Array(("num_images",), Index("num_frames", lowest=-1), np.int32),
    sensor_from_rig=Array(("num_sensors", 7), "pose", default=0),
    sensor_rig_ids=Array(("num_sensors",), dtype=np.int64),
    sensor_camera_ids=Array(("num_sensors",), dtype=np.int64),
    image_sensor=Array(("num_images",), Index("num_sensors", lowest=-1), np.int32),
    frame_rig_ids=Array(("num_frames",), dtype=np.int64),  # its default needs the others
)
"""Fields of a problem for rigs, in an order in which their defaults can be computed."""

TOLERANCE = 1e-6
"""Largest allowed difference between an image's pose and the pose computed from its rig: in entries
of the rotation, and in the translation relative to the larger translation of frame and sensor. The
poses of rigs are used, because files round the poses of images."""


# The caller checks the poses.
@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def compose(sensor_from_rig: _Poses, rig_from_world: _Poses) -> _Poses:
    """Return cam_from_world, (n, 7), from sensor_from_rig and rig_from_world, (n, 7) each."""
    return multiply_poses(unit_poses(sensor_from_rig), unit_poses(rig_from_world))


def placed(fields: Mapping[str, Any]) -> _Poses:
    """Return cam_from_world from a problem's fields; poses of images with a frame are computed.

    An image of a reference sensor gets exactly the pose of its frame, bit for bit.
    """
    poses: _Poses = fields["cam_from_world"]
    images = np.flatnonzero(fields["image_frame"] >= 0)
    if not len(images):
        return poses
    poses = poses.copy()
    frame, sensor = fields["image_frame"][images], fields["image_sensor"][images]
    poses[images] = fields["rig_from_world"][frame]
    on_arm = np.flatnonzero(sensor >= 0)
    arms = fields["sensor_from_rig"][sensor[on_arm]]
    poses[images[on_arm]] = compose(arms, poses[images[on_arm]])
    return freeze(poses)


def pose_differences(
    poses: _Poses, others: _Poses
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return the angles [rad] and the distances of the centres between poses (n, 7) and others.

    The last value is the largest distance of a centre from the origin.
    """
    one, two = inverse_poses(unit_poses(poses)), inverse_poses(unit_poses(others))
    apart = [np.linalg.norm(one[:, :4] + sign * two[:, :4], axis=1) for sign in (1, -1)]
    angle = 4 * np.arcsin(np.minimum(1.0, 0.5 * np.minimum(*apart)))
    shift = np.linalg.norm(one[:, 4:] - two[:, 4:], axis=1)
    return angle, shift, float(np.linalg.norm(one[:, 4:], axis=1).max(initial=0))


def recomputed_poses(problem: ProblemArrays, changes: Mapping[str, Any]) -> _Poses | None:
    """Return cam_from_world after changes of rigs.

    None if the changes contain cam_from_world, or arrays are invalid. Poses of images whose frame
    and sensor do not change keep their bits.
    """
    names = ("rig_from_world", "sensor_from_rig", "image_frame", "image_sensor")
    given = [name for name in names if changes.get(name) is not None]
    if "cam_from_world" in changes or not given:
        return None
    before = {name: getattr(problem, name) for name in ("cam_from_world", *names)}
    for name in names[2:]:
        if not len(before[name]):
            before[name] = np.full(problem.num_images, -1)
    try:
        after = before | {
            name: np.asarray(changes[name]).astype(ARRAYS[name].dtype, casting="same_kind")
            for name in given
        }
        poses = placed(after)
        moved = _differ(before, after)
    except (TypeError, ValueError, IndexError):
        return None  # the checks of the new problem raise the error
    if not np.isfinite(poses).all():
        return None
    return np.where(moved[:, None], poses, problem.cam_from_world)


def default(problem: ProblemArrays, name: str) -> NDArray[Any]:
    """Return the default of a field; fields before it in ARRAYS must be set."""
    if name in ("rig_from_world", "sensor_from_rig"):
        return filled((0, 7), 0, np.float64)
    num_frames = len(problem.rig_from_world)
    if name == "frame_ids":
        return freeze(np.arange(num_frames, dtype=np.int64))
    if name == "frame_rig_ids":
        return freeze(_rigs_of_frames(problem))
    count = num_frames if name == "image_frame" else len(problem.sensor_from_rig)
    if count:
        beside = "rig_from_world" if name == "image_frame" else "sensor_from_rig"
        raise InputError(f"{name}: expected numbers together with {beside}, found None")
    if name == "image_sensor" and num_frames:
        return filled((problem.num_images,), -1, np.int32)
    return filled((0,), 0, ARRAYS[name].dtype)


def settle(problem: ProblemArrays) -> None:
    """Replace index arrays that contain only -1 by empty arrays if the problem has no frames."""
    if len(problem.rig_from_world):
        return
    if len(problem.sensor_from_rig):
        raise InputError(
            "sensor_from_rig: expected no sensors without frames, found "
            f"{len(problem.sensor_from_rig)}"
        )
    for name in ("image_frame", "image_sensor"):
        rows = getattr(problem, name)
        if rows.shape != (0,):
            check_shape(name, rows, (problem.num_images,))
            _expect_none(problem, name, "frames")
            object.__setattr__(problem, name, filled((0,), 0, np.int32))


def check(problem: ProblemArrays) -> None:
    """Check that frames, sensors and rigs are consistent; the core checks all other fields."""
    check_shape("frame_rig_ids", problem.frame_rig_ids, (problem.num_frames,))
    if problem.num_frames == 0:
        return
    if not problem.num_sensors:
        _expect_none(problem, "image_sensor", "sensors")
    images = np.flatnonzero(problem.image_frame >= 0)
    frame, sensor = problem.image_frame[images], problem.image_sensor[images]
    rig = problem.frame_rig_ids[frame]
    refuse_row(
        (sensor >= 0) & (problem.sensor_rig_ids[sensor] != rig) if problem.num_sensors else (),
        lambda k: (
            f"frame_rig_ids: frame {problem.frame_ids[frame[k]]}: expected rig "
            f"{problem.sensor_rig_ids[sensor[k]]} of the sensor of image "
            f"{problem.image_ids[images[k]]}, found rig {rig[k]}"
        ),
    )
    _check_once(problem, images)
    _check_references(problem, images, rig)
    _check_poses(problem, images)


def _expect_none(problem: ProblemArrays, name: str, what: str) -> None:
    """Check that all indices are -1."""
    rows = getattr(problem, name)
    refuse_row(
        rows != -1,
        lambda k: (
            f"{name}: image {problem.image_ids[k]}: expected -1 without {what}, found {rows[k]}"
        ),
    )


def rig_of_image(problem: ProblemArrays) -> NDArray[np.int64]:
    """Return (num_images,) ids of the images' rigs; -1 for an image without a frame."""
    rig = np.full(problem.num_images, -1, np.int64)
    if problem.num_frames:
        images = problem.image_frame >= 0
        rig[images] = problem.frame_rig_ids[problem.image_frame[images]]
    return rig


def reference_cameras(problem: ProblemArrays) -> dict[int, int]:
    """Return the reference camera by rig id, for rigs whose reference camera took images."""
    rig = rig_of_image(problem)
    known: dict[int, int] = {}
    if problem.num_frames:
        images = np.flatnonzero((rig >= 0) & (problem.image_sensor < 0))
        cameras = problem.camera_ids[problem.image_camera[images]]
        known = dict(zip(rig[images].tolist(), cameras.tolist(), strict=True))
    return known


def _differ(before: Mapping[str, Any], after: Mapping[str, Any]) -> NDArray[np.bool_]:
    """Return a mask of images whose rig_from_world or sensor_from_rig has changed."""
    differ: NDArray[np.bool_] = np.zeros(len(before["cam_from_world"]), bool)
    for poses, rows in (("rig_from_world", "image_frame"), ("sensor_from_rig", "image_sensor")):
        old, new = before[rows], after[rows]
        differ |= (old >= 0) != (new >= 0)
        both = np.flatnonzero((old >= 0) & (new >= 0))
        differ[both] |= (before[poses][old[both]] != after[poses][new[both]]).any(axis=1)
    return differ


def _rigs_of_frames(problem: ProblemArrays) -> NDArray[np.int64]:
    """Return the rig of each frame: the rig of its sensors, the only rig, or its camera's rig."""
    num_frames = len(problem.rig_from_world)
    rig = np.full(num_frames, -1, np.int64)
    if not num_frames or problem.image_frame.shape != (problem.num_images,):
        return rig
    if problem.image_sensor.shape != (problem.num_images,):
        return rig
    inside = (problem.image_frame >= 0) & (problem.image_frame < num_frames)
    known = inside & (problem.image_sensor >= 0)
    known &= problem.image_sensor < len(problem.sensor_rig_ids)
    rig[problem.image_frame[known]] = problem.sensor_rig_ids[problem.image_sensor[known]]
    open_ = np.flatnonzero(rig < 0)
    if not len(open_):
        return rig
    rigs = distinct(problem.sensor_rig_ids)
    if len(rigs) <= 1:
        rig[open_] = rigs[0] if len(rigs) else 1
        return rig
    references = np.flatnonzero(inside & (problem.image_sensor < 0))
    frames = problem.image_frame[references]
    cameras = problem.image_camera[references]
    settled = rig[frames] >= 0
    of_camera = dict(zip(cameras[settled].tolist(), rig[frames[settled]].tolist(), strict=True))
    for frame, camera in zip(frames[~settled].tolist(), cameras[~settled].tolist(), strict=True):
        rig[frame] = of_camera.get(camera, -1)
    refuse_row(
        rig < 0,
        lambda k: (
            "frame_rig_ids: expected numbers, because no image determines the rig of frame "
            f"{problem.frame_ids[k]}, found None"
        ),
    )
    return rig


def _check_poses(problem: ProblemArrays, images: Any) -> None:
    """Check that the poses of images match those of their rigs, up to the rounding of files."""
    names = ("cam_from_world", "image_frame", "image_sensor", "rig_from_world", "sensor_from_rig")
    expected = placed({name: getattr(problem, name) for name in names})[images]
    given = problem.cam_from_world[images]
    turned = np.abs(rotation_matrices(given[:, :4]) - rotation_matrices(expected[:, :4]))
    turn = turned.max(axis=(1, 2))
    shift = np.abs(given[:, 4:] - expected[:, 4:]).max(axis=1)
    size = np.abs(problem.rig_from_world[problem.image_frame[images], 4:]).max(axis=1)
    sensor = problem.image_sensor[images]
    on_arm = np.flatnonzero(sensor >= 0)
    arms = np.abs(problem.sensor_from_rig[sensor[on_arm], 4:]).max(axis=1)
    size[on_arm] = np.maximum(size[on_arm], arms)
    refuse_row(
        ~((turn <= TOLERANCE) & (shift <= TOLERANCE * size)),
        lambda k: (
            f"cam_from_world: image {problem.image_ids[images[k]]}: expected sensor_from_rig * "
            f"rig_from_world of frame {problem.frame_ids[problem.image_frame[images[k]]]}, found "
            f"a rotation that differs by {turn[k]:.3g} and a translation that differs by "
            f"{shift[k]:.3g}"
        ),
    )


def _check_once(problem: ProblemArrays, images: Any) -> None:
    """Check that each sensor took at most one image in each frame."""
    pairs = np.stack([problem.image_frame[images], problem.image_sensor[images]], axis=1)
    order = np.lexsort((pairs[:, 1], pairs[:, 0]))
    twice = np.flatnonzero((pairs[order][1:] == pairs[order][:-1]).all(axis=1))
    if len(twice):
        first, second = images[order[twice[0]]], images[order[twice[0] + 1]]
        raise InputError(
            f"image_sensor: frame {problem.frame_ids[problem.image_frame[first]]}: expected one "
            f"image per sensor, found images {problem.image_ids[first]} and "
            f"{problem.image_ids[second]} of one sensor"
        )


def _check_references(problem: ProblemArrays, images: Any, rig: NDArray[np.int64]) -> None:
    """Check that a rig's reference sensor is one camera, and that no other sensor has it."""
    by_reference = problem.image_sensor[images] < 0
    cameras = problem.camera_ids[problem.image_camera[images[by_reference]]]
    reference: dict[int, int] = {}
    for one, camera, image in zip(
        rig[by_reference].tolist(), cameras.tolist(), images[by_reference].tolist(), strict=True
    ):
        if reference.setdefault(one, camera) != camera:
            raise InputError(
                f"image_sensor: image {problem.image_ids[image]}: expected camera "
                f"{reference[one]}, the reference sensor of rig {one}, found camera {camera}"
            )
    for one, camera in zip(
        problem.sensor_rig_ids.tolist(), problem.sensor_camera_ids.tolist(), strict=True
    ):
        if reference.get(one) == camera:
            raise InputError(
                f"sensor_camera_ids: rig {one}: expected another camera than that of its "
                f"reference sensor, found camera {camera}"
            )
