"""Rigs of a ``pycolmap.Reconstruction`` as the arrays of a problem.

COLMAP puts every image into a frame of a rig. A problem ignores rigs whose only camera is their
reference sensor, with or without IMUs: their images have their own poses. A problem contains every
other rig that took one of its images. Of such a rig it contains the frames with an image, and all
cameras with a known sensor_from_rig, even without images. All other records stay in the source.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError


@dataclass(frozen=True)
class RigFields:
    """Fields of a problem for the rigs of a reconstruction.

    Attributes:
        fields: fields of the problem by name.
        framed: for each image, True if it is in a frame of a rig with several cameras.
    """

    fields: dict[str, Any]
    framed: list[bool]


def rigs_of(reconstruction: pycolmap.Reconstruction, images: list[pycolmap.Image]) -> RigFields:
    """Return the fields for the rigs of these images.

    Raises:
        InputError: a frame has several images of one camera, or an image of a camera without
            sensor_from_rig.
    """
    _check_frames(reconstruction, {image.image_id for image in images})
    rigs = reconstruction.rigs
    trivial = {rig_id: is_trivial(rig) for rig_id, rig in rigs.items()}
    frame_of = [reconstruction.frame(image.frame_id) for image in images]
    framed = [not trivial[frame.rig_id] for frame in frame_of]
    frames = {f.frame_id: f for f, inside in zip(frame_of, framed, strict=True) if inside}
    frame_row = {frame_id: row for row, frame_id in enumerate(sorted(frames))}
    used = sorted({frame.rig_id for frame in frames.values()})
    sensors = [
        (rig_id, sensor)
        for rig_id in used
        for sensor in sorted(cameras_of(rigs[rig_id]), key=lambda sensor: int(sensor.id))
        if not rigs[rig_id].is_ref_sensor(sensor) and rigs[rig_id].has_sensor_from_rig(sensor)
    ]
    sensor_row = {(rig_id, sensor.id): row for row, (rig_id, sensor) in enumerate(sensors)}

    def row_of(image: pycolmap.Image, frame: pycolmap.Frame) -> int:
        rig, sensor = rigs[frame.rig_id], image.data_id.sensor_id
        if rig.is_ref_sensor(sensor):
            return -1
        row = sensor_row.get((frame.rig_id, sensor.id))
        if row is None:
            raise InputError(
                f"rig {frame.rig_id}: expected the pose of camera {sensor.id} on the rig, because "
                f"it took image {image.image_id} of frame {frame.frame_id}"
            )
        return row

    ordered = [frames[frame_id] for frame_id in sorted(frames)]
    image_frame = [
        frame_row[frame.frame_id] if inside else -1
        for frame, inside in zip(frame_of, framed, strict=True)
    ]
    image_sensor = [
        row_of(image, frame) if inside else -1
        for image, frame, inside in zip(images, frame_of, framed, strict=True)
    ]
    fields = {
        "rig_from_world": _rows([frame.rig_from_world for frame in ordered]),
        "frame_ids": np.array([frame.frame_id for frame in ordered], np.int64),
        "frame_rig_ids": np.array([frame.rig_id for frame in ordered], np.int64),
        "image_frame": np.array(image_frame if frames else [], np.int32),
        "image_sensor": np.array(image_sensor if frames else [], np.int32),
        "sensor_from_rig": _rows([rigs[rig].sensor_from_rig(sensor) for rig, sensor in sensors]),
        "sensor_rig_ids": np.array([rig_id for rig_id, _ in sensors], np.int64),
        "sensor_camera_ids": np.array([sensor.id for _, sensor in sensors], np.int64),
    }
    return RigFields(fields, framed)


def is_trivial(rig: pycolmap.Rig) -> bool:
    """Return True if the only camera of a rig is its reference sensor."""
    return all(rig.is_ref_sensor(sensor) for sensor in cameras_of(rig))


def cameras_of(rig: pycolmap.Rig) -> list[pycolmap.sensor_t]:
    """Return the sensors of a rig that are cameras."""
    return [sensor for sensor in rig.sensor_ids() if sensor.type == pycolmap.SensorType.CAMERA]


def as_row(rigid: pycolmap.Rigid3d) -> NDArray[np.float64]:
    """Return a pose as qx qy qz qw tx ty tz."""
    return np.concatenate((rigid.rotation.quat, rigid.translation))


def _rows(poses: list[pycolmap.Rigid3d | None]) -> NDArray[np.float64]:
    return np.array([as_row(pose) for pose in poses if pose is not None]).reshape(-1, 7)


def _check_frames(reconstruction: pycolmap.Reconstruction, image_ids: set[int]) -> None:
    for frame_id, frame in sorted(reconstruction.frames.items()):
        cameras = [datum.sensor_id.id for datum in frame.image_ids if datum.id in image_ids]
        for camera in cameras:
            if cameras.count(camera) > 1:
                raise InputError(
                    f"frame {frame_id}: expected at most one image of camera {camera}, "
                    f"found {cameras.count(camera)}"
                )
