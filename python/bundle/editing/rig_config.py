"""Rigs from images with their own poses, as described by COLMAP's ``rig_config.json``.

A file is a list of rigs, each an object with a list ``cameras`` of

* ``image_prefix``: prefix of the names of the camera's images;
* ``ref_sensor``: true for the reference sensor; each rig has exactly one;
* ``cam_from_rig_rotation`` (w x y z) and ``cam_from_rig_translation``: pose of the camera on the
  rig;
* ``camera_model_name`` and ``camera_params``: intrinsics that replace those of the model.

Images of a rig whose names differ only in their prefix form a frame. Missing values are computed
from the poses, as in ``pycolmap.apply_rig_config``. A sensor's rotation is the mean of the
rotations of its images relative to the reference images of their frames (the eigenvector of the
largest eigenvalue of sum q q^T; Markley et al., "Averaging Quaternions", 2007). Its position on the
rig is the mean of the positions of its images on the rig. The pose of a frame comes from its
reference image; without a reference image, from the image whose camera has the smallest id.
"""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import check_distinct, check_type
from bundle.base.records import dataclass
from bundle.errors import InputError, brief, shown
from bundle.io.formats.file_values import read_json
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.model.rig_arrays import compose, placed
from bundle.model.rigid_motions import inverse_poses, quaternion_rotate, unit_poses

_Pose = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class SensorConfig:
    """Camera of a rig."""

    image_prefix: str  # prefix of the names of the camera's images
    is_reference: bool = False  # True if the pose of the rig is the pose of this camera
    # (7,) qx qy qz qw tx ty tz; None: computed from the poses of the images
    sensor_from_rig: _Pose | None = None
    camera_model: str | None = None  # COLMAP's name of the model; None: the model of the images
    camera_params: tuple[float, ...] = ()  # parameters of this model in COLMAP's order


@dataclass(frozen=True, eq=False, kw_only=True)
class RigConfig:
    """Cameras of a rig, including one reference sensor."""

    sensors: tuple[SensorConfig, ...]


def read_rig_config(path: str | os.PathLike[str]) -> tuple[RigConfig, ...]:
    """Read COLMAP's rig_config.json; keys that COLMAP does not use are ignored."""
    content = read_json(Path(path)).value
    if not isinstance(content, list) or not content:
        raise InputError(f"{shown(path)}: expected a list of rigs, found {brief(content)}")
    return tuple(_rig(f"{shown(path)}: rig {i}", rig) for i, rig in enumerate(content, 1))


def apply_rig_config(
    problem: Problem, config: str | os.PathLike[str] | Sequence[RigConfig]
) -> Problem:
    """Return the problem with its images assigned to frames of the rigs in a file.

    Existing rigs are removed; images without a matching prefix get their own poses. Rigs are
    numbered from 1, and a frame has the smallest id of its images.

    Args:
        problem: problem with image names.
        config: path of a rig_config.json, or result of :func:`read_rig_config`.

    Raises:
        InputError: the file is invalid, an image matches two prefixes, images of a prefix have
            different cameras or sensors share one, no image matches a rig, or the pose of a sensor
            on its rig is undetermined.
        OSError: the file cannot be read.
    """
    check_type("problem", problem, Problem)
    rigs = read_rig_config(config) if isinstance(config, str | os.PathLike) else tuple(config)
    return _Assembly(problem.without_rigs(), rigs).problem()


def _rig(place: str, rig: Any) -> RigConfig:
    cameras = rig.get("cameras") if isinstance(rig, dict) else None
    if not isinstance(cameras, list) or not cameras:
        raise InputError(f"{place}: expected an object with a list 'cameras', found {brief(rig)}")
    if "ref_camera_id" in rig:
        raise InputError(
            f"{place}: expected the format of COLMAP 3.12 (image_prefix, ref_sensor: true, "
            "cam_from_rig_rotation and cam_from_rig_translation of each camera), found the older "
            "format with ref_camera_id"
        )
    sensors = tuple(_sensor(f"{place}, camera {i}", camera) for i, camera in enumerate(cameras, 1))
    count = sum(sensor.is_reference for sensor in sensors)
    if count != 1:
        raise InputError(f"{place}: expected one camera with ref_sensor true, found {count}")
    check_distinct(
        f"{place}: expected each image_prefix once", (sensor.image_prefix for sensor in sensors)
    )
    return RigConfig(sensors=sensors)


def _sensor(place: str, camera: Any) -> SensorConfig:
    check_type(place, camera, dict, "an object")
    prefix, is_reference = camera.get("image_prefix"), camera.get("ref_sensor", False)
    check_type(f"{place}: image_prefix", prefix, str, "a string")
    check_type(f"{place}: ref_sensor", is_reference, bool, "true or false")
    pose = _pose(place, camera)
    if is_reference and pose is not None:
        raise InputError(
            f"{place}: expected no cam_from_rig for the reference sensor, whose pose is "
            "that of the rig"
        )
    model = camera.get("camera_model_name")
    params: tuple[float, ...] = ()
    if model is not None:
        if model not in camera_models():
            raise InputError(
                f"{place}: camera_model_name: expected a COLMAP model, found {brief(model)}"
            )
        params = _numbers(place, camera, "camera_params", len(camera_models()[model]))
    elif camera.get("camera_params") is not None:
        raise InputError(f"{place}: expected camera_model_name together with camera_params")
    return SensorConfig(
        image_prefix=prefix,
        is_reference=is_reference,
        sensor_from_rig=pose,
        camera_model=model,
        camera_params=params,
    )


def _pose(place: str, camera: Mapping[str, Any]) -> _Pose | None:
    names = ("cam_from_rig_rotation", "cam_from_rig_translation")
    given = [name for name in names if camera.get(name) is not None]
    if not given:
        return None
    if len(given) == 1:
        other = next(name for name in names if name not in given)
        raise InputError(f"{place}: expected {other} together with {given[0]}")
    w, *xyz = _numbers(place, camera, names[0], 4)
    rotation = np.array([*xyz, w])
    norm = float(np.linalg.norm(rotation))
    if not 0 < norm < math.inf:
        raise InputError(f"{place}: {names[0]}: expected a finite norm above 0, found {norm:g}")
    return np.array([*(rotation / norm), *_numbers(place, camera, names[1], 3)])


def _numbers(place: str, camera: Mapping[str, Any], name: str, count: int) -> tuple[float, ...]:
    found = camera.get(name)
    fits = isinstance(found, list) and len(found) == count
    if not fits or not all(type(n) in (int, float) and math.isfinite(n) for n in found or ()):
        raise InputError(f"{place}: {name}: expected {count} numbers, found {brief(found)}")
    return tuple(map(float, found or ()))


class _Assembly:
    """Images sorted into frames, and the resulting arrays."""

    def __init__(self, problem: Problem, rigs: tuple[RigConfig, ...]) -> None:
        self._problem, self._rigs = problem, rigs
        self._models = list(problem.camera_models)
        self._params = problem.camera_params.copy()
        self._taken: dict[int, str] = {}  # prefix of each image
        self._poses: list[_Pose] = []  # poses of frames
        self._frame_ids: list[int] = []
        self._frame_rigs: list[int] = []
        self._arms: list[_Pose] = []
        self._arm_ids: list[tuple[int, int]] = []
        self._image_frame = np.full(problem.num_images, -1, np.int32)
        self._image_sensor = np.full(problem.num_images, -1, np.int32)

    def problem(self) -> Problem:
        """Return the problem with its rigs."""
        for rig_id, rig in enumerate(self._rigs, 1):
            self._add(rig_id, rig)
        problem = self._problem
        rigs = {
            "rig_from_world": np.array(self._poses).reshape(-1, 7),
            "sensor_from_rig": np.array(self._arms).reshape(-1, 7),
            "image_frame": self._image_frame,
            "image_sensor": self._image_sensor,
        }
        return problem.replace(
            cam_from_world=placed(rigs | {"cam_from_world": problem.cam_from_world}),
            camera_models=self._models,
            camera_params=self._params,
            frame_ids=np.array(self._frame_ids, np.int64),
            frame_rig_ids=np.array(self._frame_rigs, np.int64),
            sensor_rig_ids=np.array([rig for rig, _ in self._arm_ids], np.int64),
            sensor_camera_ids=np.array([camera for _, camera in self._arm_ids], np.int64),
            **rigs,
        )

    def _add(self, rig_id: int, rig: RigConfig) -> None:
        frames = self._frames(rig_id, rig)
        cameras = self._cameras(rig_id, rig, frames)
        reference = next(i for i, sensor in enumerate(rig.sensors) if sensor.is_reference)
        rows, arms = {reference: -1}, {reference: np.array([0.0, 0, 0, 1, 0, 0, 0])}
        for index, sensor in enumerate(rig.sensors):
            if index == reference or index not in cameras:
                continue
            arm = sensor.sensor_from_rig
            if arm is None:
                arm = self._mean_arm(rig_id, sensor, index, reference, frames)
            arms[index], rows[index] = arm, len(self._arms)
            self._arms.append(arm)
            self._arm_ids.append((rig_id, int(self._problem.camera_ids[cameras[index]])))
        for images in frames.values():
            first = min(
                images, key=lambda i: (i != reference, self._problem.camera_ids[cameras[i]])
            )
            for index, image in images.items():
                self._image_frame[image] = len(self._poses)
                self._image_sensor[image] = rows[index]
            pose = self._problem.cam_from_world[images[first]]
            self._poses.append(pose if first == reference else _relative(arms[first], pose))
            self._frame_ids.append(int(self._problem.image_ids[list(images.values())].min()))
            self._frame_rigs.append(rig_id)

    def _frames(self, rig_id: int, rig: RigConfig) -> dict[str, dict[int, int]]:
        """Return the images of each frame: by the name without the prefix, then by sensor."""
        frames: dict[str, dict[int, int]] = defaultdict(dict)
        order = np.argsort(self._problem.image_ids, kind="stable").tolist()
        for image in order:
            name = self._problem.image_names[image]
            for index, sensor in enumerate(rig.sensors):
                prefix = sensor.image_prefix
                if not name.startswith(prefix):
                    continue
                other = self._taken.setdefault(image, prefix)
                if other != prefix:
                    raise InputError(
                        f"rig {rig_id}: expected one image_prefix for {shown(name)}, found "
                        f"{other!r} and {prefix!r}"
                    )
                suffix = name[len(prefix) :]
                if index in frames[suffix]:
                    raise InputError(
                        f"rig {rig_id}: expected unique names, found {shown(name)} twice"
                    )
                frames[suffix][index] = image
        if not frames:
            prefixes = ", ".join(repr(sensor.image_prefix) for sensor in rig.sensors)
            raise InputError(
                f"rig {rig_id}: expected images whose names begin with {prefixes}, found 0"
            )
        return frames

    def _cameras(
        self, rig_id: int, rig: RigConfig, frames: Mapping[str, Mapping[int, int]]
    ) -> dict[int, int]:
        """Set the intrinsics of the cameras of sensors with images; return their rows by sensor."""
        ids, cameras = self._problem.camera_ids, dict[int, int]()
        for images in frames.values():
            for index, image in images.items():
                camera = int(self._problem.image_camera[image])
                if cameras.setdefault(index, camera) != camera:
                    raise InputError(
                        f"rig {rig_id}: expected one camera for the images of prefix "
                        f"{rig.sensors[index].image_prefix!r}, found cameras "
                        f"{ids[cameras[index]]} and {ids[camera]}"
                    )
        for index, camera in cameras.items():
            other = next((i for i, c in cameras.items() if c == camera and i < index), None)
            if other is not None:
                raise InputError(
                    f"rig {rig_id}: expected a camera for each sensor, found camera {ids[camera]} "
                    f"for the prefixes {rig.sensors[other].image_prefix!r} and "
                    f"{rig.sensors[index].image_prefix!r}"
                )
            sensor = rig.sensors[index]
            if sensor.camera_model is not None:
                self._set_intrinsics(camera, sensor.camera_model, sensor.camera_params)
        return cameras

    def _set_intrinsics(self, camera: int, model: str, params: tuple[float, ...]) -> None:
        missing = len(params) - self._params.shape[1]
        if missing > 0:
            self._params = np.pad(self._params, ((0, 0), (0, missing)))
        self._models[camera] = model
        self._params[camera] = 0
        self._params[camera, : len(params)] = params

    def _mean_arm(
        self,
        rig_id: int,
        sensor: SensorConfig,
        index: int,
        reference: int,
        frames: Mapping[str, Mapping[int, int]],
    ) -> _Pose:
        both = [images for images in frames.values() if index in images and reference in images]
        if not both:
            raise InputError(
                f"rig {rig_id}: the pose of the sensor with prefix {sensor.image_prefix!r} is "
                "undetermined: expected cam_from_rig, or a frame with one of its images and a "
                "reference image"
            )
        poses = self._problem.cam_from_world
        sensors = poses[[images[index] for images in both]]
        references = poses[[images[reference] for images in both]]
        arms = compose(sensors, inverse_poses(unit_poses(references)))
        rotation = np.linalg.eigh(arms[:, :4].T @ arms[:, :4])[1][:, -1]
        center = inverse_poses(arms)[:, 4:].mean(axis=0)
        return np.hstack([rotation, -quaternion_rotate(rotation[None], center[None])[0]])


def _relative(arm: _Pose, pose: _Pose) -> _Pose:
    """Return the pose of the frame whose sensor at `arm` has the pose `pose`."""
    frame: _Pose = compose(inverse_poses(unit_poses(arm[None])), pose[None])[0]
    return frame
