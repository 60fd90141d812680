"""Rigs of a problem written into a reconstruction.

Where each image is in the frame in which the source has it, the poses of frames and sensors are
written and everything else of the source's rigs stays: IMUs, sensors without images, frames without
images. Where images have changed frames, or sensors rigs, all frames and rigs are made anew from
the problem, and what only the source knew of them is gone.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
import pycolmap
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.model import rig_arrays
from bundle.model.problem import Problem
from bundle.model.pycolmap.colmap_rigs import cameras_of, is_trivial

__all__ = [
    "check_rigs",
    "fits",
    "reframed",
    "rigid3d",
    "taken_apart",
    "without_parts_of_frames",
    "write_poses",
]

MAX_ID = 2**32 - 2


def rigid3d(pose: NDArray[np.float64]) -> pycolmap.Rigid3d:
    """Return a pose qx qy qz qw tx ty tz as pycolmap has it."""
    return pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:4]), pose[4:])


def fits(source: pycolmap.Reconstruction, problem: Problem) -> bool:
    """Tell whether the rigs of a problem are the source's, with other poses and fewer images."""
    sensors = set(
        zip(problem.sensor_rig_ids.tolist(), problem.sensor_camera_ids.tolist(), strict=True)
    )
    known: set[tuple[int, int]] = set()
    for rig_id in set(problem.frame_rig_ids.tolist()):
        if rig_id not in source.rigs or is_trivial(source.rigs[rig_id]):
            return False
        rig = source.rigs[rig_id]
        cameras = cameras_of(rig)
        if not {sensor.id for sensor in cameras} <= set(problem.camera_ids.tolist()):
            return False
        known |= {(rig_id, sensor.id) for sensor in cameras if rig.has_sensor_from_rig(sensor)}
    if sensors != known:
        return False
    rig_ids = rig_arrays.rig_of_image(problem).tolist()
    for index, image_id in enumerate(problem.image_ids.tolist()):
        framed = rig_ids[index] >= 0
        if not source.exists_image(image_id):
            if framed:
                return False
            continue
        image = source.image(image_id)
        frame = source.frame(image.frame_id)
        rig = source.rigs[frame.rig_id]
        if framed == is_trivial(rig):
            return False
        if not framed:
            continue
        row = problem.image_frame[index]
        same = (
            frame.frame_id == problem.frame_ids[row]
            and frame.rig_id == problem.frame_rig_ids[row]
            and image.camera_id == problem.camera_ids[problem.image_camera[index]]
            and rig.is_ref_sensor(image.data_id.sensor_id) == (problem.image_sensor[index] < 0)
        )
        if not same:
            return False
    return True


def write_poses(reconstruction: pycolmap.Reconstruction, problem: Problem) -> None:
    """Write where frames and sensors are, of rigs that fit."""
    for frame_id, pose in zip(problem.frame_ids.tolist(), problem.rig_from_world, strict=True):
        if frame_id not in reconstruction.frames:
            continue  # none of its images is in the problem
        frame = reconstruction.frame(frame_id)
        is_registered = frame.has_pose()
        frame.rig_from_world = rigid3d(pose)
        if not is_registered:
            reconstruction.register_frame(frame_id)
    for rig_id, sensor, pose in _sensors(problem):
        reconstruction.rigs[rig_id].set_sensor_from_rig(sensor, pose)


def without_parts_of_frames(
    reconstruction: pycolmap.Reconstruction, image_ids: set[int]
) -> tuple[pycolmap.Reconstruction, set[int]]:
    """Remove images, which observe no point any more, from frames that have others.

    Returns:
        The reconstruction, another one where there are such frames, as pycolmap's frames cannot
        lose an image; and the images that are left to be removed, with their frames.
    """
    partial = {
        frame_id
        for frame_id, frame in reconstruction.frames.items()
        if 0 < sum(datum.id in image_ids for datum in frame.image_ids) < len(list(frame.image_ids))
    }
    gone = {i for i in image_ids if reconstruction.image(i).frame_id in partial}
    if not gone:
        return reconstruction, image_ids
    result = _with_cameras(reconstruction)
    for _, rig in sorted(reconstruction.rigs.items()):
        result.add_rig(rig)
    for frame_id, frame in sorted(reconstruction.frames.items()):
        data = [datum for datum in frame.data_ids if not (_is_image(datum) and datum.id in gone)]
        images = [reconstruction.image(datum.id) for datum in data if _is_image(datum)]
        _add_frame(result, frame_id, frame.rig_id, frame.rig_from_world, images, data)
    return _with_points(result, reconstruction), image_ids - gone


def taken_apart(reconstruction: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """Return a reconstruction in which each image with a pose has a frame and a rig of its own."""
    apart = _with_cameras(reconstruction)
    for camera_id in sorted(reconstruction.cameras):
        _add_rig(apart, camera_id, camera_id)
    for image_id in sorted(reconstruction.reg_image_ids()):
        image = reconstruction.image(image_id)
        _add_frame(apart, image_id, image.camera_id, image.cam_from_world(), [image])
    return _with_points(apart, reconstruction)


def reframed(reconstruction: pycolmap.Reconstruction, problem: Problem) -> pycolmap.Reconstruction:
    """Return a reconstruction of the same images in the frames and rigs of a problem."""
    result = _with_cameras(reconstruction)
    for rig_id, camera_id in sorted(_references(problem, None).items()):
        _add_rig(result, rig_id, camera_id)
    for rig_id, sensor, pose in _sensors(problem):
        result.rigs[rig_id].add_sensor(sensor, pose)
    frame_of = problem.image_frame if problem.num_frames else np.full(problem.num_images, -1)
    members: dict[int, list[pycolmap.Image]] = defaultdict(list)
    for image_id, frame in zip(problem.image_ids.tolist(), frame_of.tolist(), strict=True):
        members[frame].append(reconstruction.image(image_id))
    for row, frame_id in enumerate(problem.frame_ids.tolist()):
        if members[row]:
            rig_id = int(problem.frame_rig_ids[row])
            pose = rigid3d(problem.rig_from_world[row])
            _add_frame(result, frame_id, rig_id, pose, members[row])
    own_rig: dict[int, int] = {}
    for image in members[-1]:
        if image.camera_id not in own_rig:
            own_rig[image.camera_id] = _free(result.rigs, image.camera_id)
            _add_rig(result, own_rig[image.camera_id], image.camera_id)
        pose = image.cam_from_world()
        frame_id = _free(result.frames, image.image_id)
        _add_frame(result, frame_id, own_rig[image.camera_id], pose, [image])
    used = {sensor.id for rig in result.rigs.values() for sensor in cameras_of(rig)}
    for camera_id in sorted(set(reconstruction.cameras) - used):
        _add_rig(result, _free(result.rigs, camera_id), camera_id)
    return _with_points(result, reconstruction)


def check_rigs(problem: Problem, source: pycolmap.Reconstruction | None) -> None:
    """Raise an InputError for ids that COLMAP cannot hold and rigs without a reference sensor."""
    for name in ("frame_ids", "frame_rig_ids", "sensor_rig_ids", "sensor_camera_ids"):
        ids = getattr(problem, name)
        outside = (ids < 0) | (ids > MAX_ID)
        if outside.any():
            raise InputError(f"{name}: expected ids from 0 to {MAX_ID}, found {ids[outside][0]}")
    unknown = ~np.isin(problem.sensor_camera_ids, problem.camera_ids)
    if unknown.any():
        raise InputError(
            f"sensor_camera_ids: expected cameras of the problem, found camera "
            f"{problem.sensor_camera_ids[unknown][0]}"
        )
    _references(problem, source)


def _references(problem: Problem, source: pycolmap.Reconstruction | None) -> dict[int, int]:
    """Return the reference camera of each rig that has a frame."""
    references = rig_arrays.reference_cameras(problem)
    for rig_id in np.unique(problem.frame_rig_ids).tolist():
        if rig_id not in references and (source is None or not fits(source, problem)):
            raise InputError(
                f"frame_rig_ids: rig {rig_id}: expected an image of its reference sensor, which "
                "COLMAP has to know, found none"
            )
    return references


def _sensors(problem: Problem) -> Iterator[tuple[int, pycolmap.sensor_t, pycolmap.Rigid3d]]:
    """Yield the rig of each sensor, the sensor and sensor_from_rig."""
    for rig_id, camera_id, pose in zip(
        problem.sensor_rig_ids.tolist(),
        problem.sensor_camera_ids.tolist(),
        problem.sensor_from_rig,
        strict=True,
    ):
        yield rig_id, pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id), rigid3d(pose)


def _with_cameras(reconstruction: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    result = pycolmap.Reconstruction()
    for _, camera in sorted(reconstruction.cameras.items()):
        result.add_camera(camera)
    return result


def _add_rig(reconstruction: pycolmap.Reconstruction, rig_id: int, camera_id: int) -> None:
    rig = pycolmap.Rig()
    rig.rig_id = rig_id
    rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera_id))
    reconstruction.add_rig(rig)


def _add_frame(
    reconstruction: pycolmap.Reconstruction,
    frame_id: int,
    rig_id: int,
    pose: pycolmap.Rigid3d | None,
    images: list[pycolmap.Image],
    data: list[pycolmap.data_t] | None = None,
) -> None:
    frame = pycolmap.Frame()
    frame.frame_id, frame.rig_id = frame_id, rig_id
    for datum in [image.data_id for image in images] if data is None else data:
        frame.add_data_id(datum)
    if pose is not None:
        frame.rig_from_world = pose
    reconstruction.add_frame(frame)
    for image in images:
        copy = pycolmap.Image(image.name, image.points2D, image.camera_id, image.image_id)
        for keypoint in copy.get_observation_point2D_idxs():
            copy.reset_point3D_for_point2D(int(keypoint))
        copy.frame_id = frame_id
        reconstruction.add_image(copy)


def _is_image(datum: pycolmap.data_t) -> bool:
    return bool(datum.sensor_id.type == pycolmap.SensorType.CAMERA)


def _with_points(
    result: pycolmap.Reconstruction, reconstruction: pycolmap.Reconstruction
) -> pycolmap.Reconstruction:
    for point_id, point in reconstruction.points3D.items():
        result.add_point3D_with_id(point_id, point)
    return result


def _free(taken: pycolmap.RigMap | pycolmap.FrameMap, wanted: int) -> int:
    return wanted if wanted not in taken else max(taken) + 1
