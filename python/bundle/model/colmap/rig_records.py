"""Rigs and frames of a problem as COLMAP writes them.

If every image is in the same frame as in the source, the poses of frames and sensors are replaced.
All other data of the source's rigs stay: IMUs, sensors without images, frames without images. If an
image has changed its frame, or a sensor its rig, all frames and rigs are created from the problem.
Data of rigs that only the source has are then lost.

If an image was removed, its frame is removed too, unless it has other images. If a camera was
removed, all rigs that contain it are removed. The rig of a camera without images stays as long as
the problem has the camera.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct, refuse_row
from bundle.errors import InputError
from bundle.model import rig_arrays
from bundle.model.colmap.source_records import (
    CAMERA,
    Datum,
    Frame,
    Pose,
    Sensor,
    SourceRecords,
    frame_of_image,
    is_trivial,
)
from bundle.model.problem_arrays import ProblemArrays

MAX_ID = 2**32 - 2  # COLMAP's largest id; the next number marks a missing id

_Rigs = dict[int, list[Sensor]]
_Frames = dict[int, Frame]


def check_rigs(problem: ProblemArrays, source: SourceRecords) -> None:
    """Check that COLMAP can hold the rigs of a problem."""
    for name in ("frame_ids", "frame_rig_ids", "sensor_rig_ids", "sensor_camera_ids"):
        ids = getattr(problem, name)
        check_ids(name, "ids", ids, MAX_ID)
    refuse_row(
        ~np.isin(problem.sensor_camera_ids, problem.camera_ids),
        lambda k: (
            f"sensor_camera_ids: expected cameras of the problem, found camera "
            f"{problem.sensor_camera_ids[k]}"
        ),
    )
    references = rig_arrays.reference_cameras(problem)
    for name in ("frame_rig_ids", "sensor_rig_ids"):
        for rig_id in distinct(getattr(problem, name)).tolist():
            if rig_id not in references and not _fits(problem, source):
                raise InputError(
                    f"{name}: rig {rig_id}: expected an image of its reference sensor, which "
                    "COLMAP requires; the problem has no such image"
                )


def check_ids(name: str, words: str, ids: NDArray[np.int64], largest: int) -> None:
    """Check that ids are from 0 to the largest that a file can hold."""
    refuse_row(
        (ids < 0) | (ids > largest),
        lambda k: f"{name}: expected {words} from 0 to {largest}, found {ids[k]}",
    )


def edited_rigs(problem: ProblemArrays, source: SourceRecords) -> tuple[_Rigs, _Frames]:
    """Return the rigs and the frames of a problem, by id.

    Frames are in the order in which COLMAP would register them. Frames without a pose come from the
    source; files cannot hold them.
    """
    rigs, frames = _kept(problem, source) if _fits(problem, source) else _made_anew(problem)
    by_type_and_id = {
        rig_id: [*sensors[:1], *sorted(sensors[1:], key=lambda sensor: sensor[:2])]
        for rig_id, sensors in sorted(rigs.items())
    }
    return by_type_and_id, {
        frame_id: frame._replace(data=tuple(sorted(frame.data)))
        for frame_id, frame in frames.items()
    }


def _fits(problem: ProblemArrays, source: SourceRecords) -> bool:
    """Return True if a problem's rigs differ from the source's in poses and removed images only."""
    known: set[tuple[int, int]] = set()
    camera_ids = set(problem.camera_ids.tolist())
    for rig_id in {*problem.frame_rig_ids.tolist(), *problem.sensor_rig_ids.tolist()}:
        sensors = source.rigs.get(rig_id)
        if sensors is None or is_trivial(sensors):
            return False
        if not {sensor.id for sensor in sensors if sensor.type == CAMERA} <= camera_ids:
            return False
        known |= {
            (rig_id, sensor.id)
            for sensor in sensors[1:]
            if sensor.type == CAMERA and sensor.pose is not None
        }
    if {(rig_id, camera_id) for rig_id, camera_id, _ in _sensors(problem)} != known:
        return False
    frame_id_of = {i: f for f, frame in source.frames.items() for i in frame.image_ids}
    camera_of_image = _cameras_of_images(source)
    framed = rig_arrays.rig_of_image(problem) >= 0
    for index, image_id in enumerate(problem.image_ids.tolist()):
        if image_id not in frame_id_of:
            if framed[index]:
                return False
            continue
        frame_id = frame_id_of[image_id]
        rig_id = source.frames[frame_id].rig_id
        if framed[index] == is_trivial(source.rigs[rig_id]):
            return False
        if not framed[index]:
            continue
        row = problem.image_frame[index]
        camera_id = camera_of_image[image_id]
        is_reference = source.rigs[rig_id][0][:2] == (CAMERA, camera_id)
        same = (
            frame_id == problem.frame_ids[row]
            and rig_id == problem.frame_rig_ids[row]
            and camera_id == problem.camera_ids[problem.image_camera[index]]
            and is_reference == (problem.image_sensor[index] < 0)
        )
        if not same:
            return False
    return True


def _kept(problem: ProblemArrays, source: SourceRecords) -> tuple[_Rigs, _Frames]:
    """Return the source's rigs and frames with the poses and the images of a problem."""
    frames = _without_images(source, set(problem.image_ids.tolist()))
    frame_id_of = {i: f for f, frame in frames.items() for i in frame.image_ids}
    camera_of_image = _cameras_of_images(source)
    rigs = dict(source.rigs)
    own_rig: dict[int, int] = {}
    for rig_id, sensors in sorted(rigs.items()):
        if sensors and sensors[0].type == CAMERA and is_trivial(sensors):
            own_rig.setdefault(sensors[0].id, rig_id)
    framed = rig_arrays.rig_of_image(problem) >= 0
    for image_id, camera_id, pose in _free_images(problem, ~framed):
        frame_id = frame_id_of.get(image_id, -1)
        if frame_id >= 0 and camera_of_image[image_id] == camera_id:
            _move(frames, frame_id, pose)
            continue
        if frame_id >= 0:
            del frames[frame_id]
        else:
            frame_id = _free(frames, image_id)
        if camera_id not in own_rig:
            own_rig[camera_id] = _free(rigs, camera_id)
            rigs[own_rig[camera_id]] = [Sensor(CAMERA, camera_id)]
        frames[frame_id] = frame_of_image(own_rig[camera_id], image_id, camera_id, pose)
    camera_ids = set(problem.camera_ids.tolist())
    rigs = {
        rig_id: sensors
        for rig_id, sensors in rigs.items()
        if all(sensor.type != CAMERA or sensor.id in camera_ids for sensor in sensors)
    }
    frames = {f: frame for f, frame in frames.items() if frame.rig_id in rigs}
    for frame_id, pose in zip(
        problem.frame_ids.tolist(), problem.rig_from_world.tolist(), strict=True
    ):
        if frame_id in frames:  # otherwise the problem has no image of the frame
            _move(frames, frame_id, tuple(pose))
    moved = {(rig_id, camera_id): pose for rig_id, camera_id, pose in _sensors(problem)}
    for rig_id in {rig_id for rig_id, _ in moved}:
        rigs[rig_id] = [
            sensor._replace(pose=moved.get((rig_id, sensor.id), sensor.pose))
            if sensor.type == CAMERA
            else sensor
            for sensor in rigs[rig_id]
        ]
    return rigs, frames


def _move(frames: _Frames, frame_id: int, pose: Pose) -> None:
    """Set the pose of a frame; a frame that had no pose moves to the end of the order."""
    moved = frames[frame_id]._replace(pose=pose)
    if frames[frame_id].pose is None:
        del frames[frame_id]
    frames[frame_id] = moved


def _without_images(source: SourceRecords, image_ids: set[int]) -> _Frames:
    """Return the source's frames without removed images; frames without a pose stay unchanged."""
    frames: _Frames = {}
    for frame_id, frame in source.frames.items():
        if frame.pose is None and image_ids.isdisjoint(frame.image_ids):
            frames[frame_id] = frame
            continue
        data = tuple(d for d in frame.data if d.type != CAMERA or d.id in image_ids)
        kept = frame._replace(data=data)
        if kept.image_ids or not frame.image_ids:
            frames[frame_id] = kept
    # COLMAP cannot remove an image from a frame: if a frame loses one, all are registered again.
    is_partial = any(len(frames[f].data) < len(source.frames[f].data) for f in frames)
    return dict(sorted(frames.items())) if is_partial else frames


def _made_anew(problem: ProblemArrays) -> tuple[_Rigs, _Frames]:
    """Return rigs and frames created from a problem without its source.

    Images without a frame get one rig per camera.
    """
    rigs: _Rigs = {
        rig_id: [Sensor(CAMERA, camera_id)]
        for rig_id, camera_id in sorted(rig_arrays.reference_cameras(problem).items())
    }
    for rig_id, camera_id, pose in _sensors(problem):
        rigs[rig_id].append(Sensor(CAMERA, camera_id, pose))
    frame_of = problem.image_frame if problem.num_frames else np.full(problem.num_images, -1)
    data: dict[int, list[Datum]] = {}
    camera_ids = problem.camera_ids[problem.image_camera].tolist()
    for row, image_id, camera_id in zip(
        frame_of.tolist(), problem.image_ids.tolist(), camera_ids, strict=True
    ):
        data.setdefault(row, []).append(Datum(CAMERA, camera_id, image_id))
    frames: _Frames = {
        frame_id: Frame(rig_id, tuple(pose), tuple(data[row]))
        for row, (frame_id, rig_id, pose) in enumerate(
            zip(
                problem.frame_ids.tolist(),
                problem.frame_rig_ids.tolist(),
                problem.rig_from_world.tolist(),
                strict=True,
            )
        )
        if row in data
    }
    own_rig: dict[int, int] = {}
    for image_id, camera_id, pose in _free_images(problem, frame_of < 0):
        if camera_id not in own_rig:
            own_rig[camera_id] = _free(rigs, camera_id)
            rigs[own_rig[camera_id]] = [Sensor(CAMERA, camera_id)]
        frame_id = _free(frames, image_id)
        frames[frame_id] = frame_of_image(own_rig[camera_id], image_id, camera_id, pose)
    used = {sensor.id for sensors in rigs.values() for sensor in sensors}
    for camera_id in sorted(set(problem.camera_ids.tolist()) - used):
        rigs[_free(rigs, camera_id)] = [Sensor(CAMERA, camera_id)]
    return rigs, frames


def _sensors(problem: ProblemArrays) -> Iterator[tuple[int, int, Pose]]:
    """Yield rig, camera and sensor_from_rig of each sensor."""
    for rig_id, camera_id, pose in zip(
        problem.sensor_rig_ids.tolist(),
        problem.sensor_camera_ids.tolist(),
        problem.sensor_from_rig.tolist(),
        strict=True,
    ):
        yield rig_id, camera_id, tuple(pose)


def _free_images(
    problem: ProblemArrays, chosen: NDArray[np.bool_]
) -> Iterator[tuple[int, int, Pose]]:
    """Yield id, camera and pose of chosen images."""
    camera_ids = problem.camera_ids[problem.image_camera[chosen]].tolist()
    for image_id, camera_id, pose in zip(
        problem.image_ids[chosen].tolist(),
        camera_ids,
        problem.cam_from_world[chosen].tolist(),
        strict=True,
    ):
        yield image_id, camera_id, tuple(pose)


def _cameras_of_images(source: SourceRecords) -> dict[int, int]:
    return dict(zip(source.image_ids.tolist(), source.image_camera_ids.tolist(), strict=True))


def _free(taken: _Rigs | _Frames, wanted: int) -> int:
    """Return an unused id, if possible the wanted one."""
    return wanted if wanted not in taken else max(taken) + 1
