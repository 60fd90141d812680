"""Rigs of OpenSfM as rigs of COLMAP.

OpenSfM has rig cameras, with a pose c_from_instance each, and instances, with a pose
instance_from_world and one shot per rig camera. In COLMAP a camera is both the lens and the place
on the rig, and the pose of a rig is that of its reference sensor. Therefore

- each pair of rig camera and lens becomes a camera,
- rig cameras that occur in one instance form a rig; its reference is the first of them,
- rig_from_world = reference_from_instance * instance_from_world,
- sensor_from_rig = sensor_from_instance * reference_from_instance^-1.

An instance of one shot whose rig camera is in no other instance with several shots is an image with
a pose of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.io.formats.json_fields import Node
from bundle.model.rig_arrays import placed, pose_differences
from bundle.model.rigid_motions import inverse_poses, multiply_poses
from bundle.model.rotations import quaternion_from_vector

Array = NDArray[np.float64]
_TOLERANCE = 1e-6


@dataclass(frozen=True)
class RigFields:
    """Fields of the problem that rigs determine.

    Attributes:
        image_camera: (num_images,) camera of each image.
        camera: (num_cameras,) camera of the file of each camera.
        fields: ``cam_from_world`` and the fields of rigs.
        notes: sentences about rigs.
    """

    image_camera: NDArray[np.int32]
    camera: NDArray[np.intp]
    fields: Mapping[str, Any]
    notes: tuple[str, ...] = ()


def rig_fields(
    node: Node, shots: list[str], image_camera: NDArray[np.int32], poses: Array
) -> RigFields:
    """Return the rigs of a reconstruction.

    Args:
        node: the reconstruction.
        shots: names of the shots.
        image_camera: (num_images,) camera of each shot.
        poses: (num_images, 7) poses of the shots.

    Raises:
        InputError: a rig is invalid, or contradicts the pose of a shot.
    """
    num_cameras = int(image_camera.max(initial=-1)) + 1
    declared = len(node.get("cameras").value)
    plain = RigFields(
        image_camera, np.arange(max(num_cameras, declared)), {"cam_from_world": poses}
    )
    members = _members(node, shots)
    if not any(len(instance) > 1 for instance in members.values()):
        return plain
    return _with_rigs(node, members, image_camera, poses, declared)


def _members(node: Node, shots: list[str]) -> dict[str, list[tuple[int, str]]]:
    """Return the shots of each instance: index and name of the rig camera."""
    place = {name: index for index, name in enumerate(shots)}
    found: dict[str, list[tuple[int, str]]] = {}
    for name, instance in (node.find("rig_instances") or Node({}, node.place)).items():
        ids = instance.find("rig_camera_ids")
        if ids is None:
            continue
        found[name] = [(place[shot], rig.text()) for shot, rig in ids.items() if shot in place]
        if len({rig for _, rig in found[name]}) < len(found[name]):
            ids.fail("each rig camera at most once")
    return found


def _pose(node: Node) -> Array:
    rotation, translation = (node.get(name).numbers(3) for name in ("rotation", "translation"))
    if np.abs(rotation).max() > 1e6:
        node.get("rotation").fail("a rotation vector in radians")
    return np.concatenate([quaternion_from_vector(rotation[None])[0], translation])


def _with_rigs(
    node: Node,
    members: dict[str, list[tuple[int, str]]],
    image_camera: NDArray[np.int32],
    poses: Array,
    num_declared: int,
) -> RigFields:
    rig_cameras = node.get("rig_cameras")
    group = _groups(members)
    pairs: dict[tuple[int, str], int] = {}  # lens and rig camera -> camera
    new_camera = image_camera.copy()
    lenses = list(range(num_declared))
    for instance in members.values():
        for image, rig_camera in instance:
            if rig_camera not in group:
                continue
            pair = (int(image_camera[image]), rig_camera)
            if pair not in pairs:
                is_first = all(lens != pair[0] for lens, _ in pairs)
                pairs[pair] = pair[0] if is_first else len(lenses)
                if not is_first:
                    lenses.append(pair[0])
            new_camera[image] = pairs[pair]
    in_group = {image for m in members.values() for image, rig in m if rig in group}
    for image in range(len(image_camera)):  # a lens on a rig and elsewhere: a copy for elsewhere
        if image not in in_group and any(lens == image_camera[image] for lens, _ in pairs):
            pair = (int(image_camera[image]), "")
            if pair not in pairs:
                pairs[pair] = len(lenses)
                lenses.append(pair[0])
            new_camera[image] = pairs[pair]
    arms = {name: _pose(rig_cameras.get(name)) for name in group}
    sensors = {pair: camera for pair, camera in pairs.items() if pair[1] in group}
    reference: dict[int, tuple[int, str]] = {}
    for pair in sensors:
        reference.setdefault(group[pair[1]], pair)
    others = [pair for pair in sensors if pair not in reference.values()]
    frame_poses: list[Array] = []
    frame_rigs: list[int] = []
    frames: list[int] = []
    image_frame = np.full(len(image_camera), -1, np.int32)
    image_sensor = np.full(len(image_camera), -1, np.int32)
    for name, instance in members.items():
        if not any(rig in group for _, rig in instance):
            continue
        rig = group[instance[0][1]]
        own = _pose(node.get("rig_instances").get(name))
        frame_poses.append(_product(arms[reference[rig][1]], own))
        frame_rigs.append(rig)
        frames.append(len(frames))
        for image, rig_camera in instance:
            pair = (int(image_camera[image]), rig_camera)
            image_frame[image] = frames[-1]
            image_sensor[image] = others.index(pair) if pair in others else -1
    back = {rig: inverse_poses(arms[pair[1]][None])[0] for rig, pair in reference.items()}
    from_rig = [_product(arms[pair[1]], back[group[pair[1]]]) for pair in others]
    fields = {
        "rig_from_world": np.array(frame_poses).reshape(-1, 7),
        "frame_ids": np.array(frames, np.int64),
        "frame_rig_ids": np.array(frame_rigs, np.int64),
        "image_frame": image_frame,
        "image_sensor": image_sensor,
        "sensor_from_rig": np.array(from_rig).reshape(-1, 7),
        "sensor_rig_ids": np.array([group[rig] for _, rig in others], np.int64),
        "sensor_camera_ids": np.array([sensors[pair] for pair in others], np.int64),
    }
    placed_poses = placed({"cam_from_world": poses, **fields})
    _check_agreement(node, members, poses, placed_poses)
    copies = len(lenses) - num_declared
    notes = (f"{copies} copies of cameras were made: COLMAP has a camera per place on a rig.",)
    return RigFields(
        new_camera,
        np.array(lenses, np.intp),
        {"cam_from_world": placed_poses, **fields},
        notes if copies else (),
    )


def _groups(members: dict[str, list[tuple[int, str]]]) -> dict[str, int]:
    """Return the rig of each rig camera that shares an instance with another."""
    group: dict[str, int] = {}
    for instance in members.values():
        names = [rig for _, rig in instance]
        if len(names) < 2:
            continue
        joined = {group[name] for name in names if name in group}
        number = min(joined, default=len(group))
        for name in [*names, *(name for name, old in group.items() if old in joined)]:
            group[name] = number
    order = {old: new for new, old in enumerate(dict.fromkeys(group.values()))}
    return {name: order[old] for name, old in group.items()}


def _product(a: Array, b: Array) -> Array:
    product: Array = multiply_poses(a[None], b[None])[0]
    return product


def _check_agreement(
    node: Node, members: dict[str, list[tuple[int, str]]], poses: Array, others: Array
) -> None:
    angle, shift, spread = pose_differences(others, poses)
    for name, instance in members.items():
        for image, _ in instance:
            if angle[image] > _TOLERANCE or shift[image] > _TOLERANCE * max(spread, 1e-300):
                raise InputError(
                    f"{node.place}: rig_instances: {name}: expected the poses of its shots, found "
                    f"a difference of {np.degrees(angle[image]):.3g} degrees and "
                    f"{shift[image]:.3g} units"
                )
