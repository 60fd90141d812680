"""OpenMVG's scenes, sfm_data.json.

A view names its photograph, intrinsics and pose; a pose is a rotation R and a centre C, and a world
point X is R (X - C) in the camera frame, x right, y down, z forward. Pixels are kept as they are in
the file, as OpenMVG's own export to COLMAP does. The file is cereal's JSON: an entry of a map is
``{"key": k, "value": v}``, and the name of a polymorphic type is written at its first occurrence
only, with its number + 2^31.

Source: openMVG/sfm/sfm_data_io_cereal.cpp, https://openmvg.readthedocs.io.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.io.formats.imported_model import (
    Imported,
    all_differ,
    by_camera,
    checked_rotations,
    poses_of,
    unique_keys,
)
from bundle.io.formats.json_fields import Node, parsed
from bundle.io.formats.openmvg_cameras import KINDS, MvgCamera, as_model, project, read_camera
from bundle.io.formats.read_options import ReadOptions
from bundle.model.problem import Problem

Array = NDArray[np.float64]
FIRST = 1 << 31
"""Added to the number of a polymorphic type where its name is written."""
_MOST_ID = 2**32 - 1


class _View(NamedTuple):
    name: str
    intrinsic: int
    pose: int


def read(path: Path, options: ReadOptions) -> Problem:
    """Read an OpenMVG scene.

    Raises:
        InputError: the file violates its format.
        OSError: the file cannot be read.
    """
    structure = _core.read_openmvg(path, options.progress)
    node = parsed(structure["rest"], path)
    views = {key: _view(value) for key, value in _map(node.get("views"))}
    cameras = dict(_intrinsics(node.get("intrinsics")))
    poses = dict(_map(node.get("extrinsics")))
    return _imported(path, node, views, cameras, poses, structure).problem()


def _map(node: Node) -> Iterator[tuple[int, Node]]:
    """Yield keys and values of a map.

    Raises:
        InputError: an entry is invalid, or a key occurs twice.
    """
    seen = set()
    for entry in node.entries():
        key = entry.get("key").whole(_MOST_ID)
        if key in seen:
            entry.get("key").fail("each key once")
        seen.add(key)
        yield key, entry.get("value")


def _view(value: Node) -> _View:
    data = value.get("ptr_wrapper").get("data")
    data = data.find("View") or data
    return _View(
        name=_name(data),
        intrinsic=data.get("id_intrinsic").whole(_MOST_ID),
        pose=data.get("id_pose").whole(_MOST_ID),
    )


def _name(data: Node) -> str:
    """Return the path of a photograph below root_path; OpenMVG writes "/" for an empty folder."""
    folder = data.find("local_path")
    name = data.get("filename").text()
    return name if folder is None or folder.value in ("", "/") else folder.text() + name


def _intrinsics(node: Node) -> Iterator[tuple[int, MvgCamera]]:
    kinds: dict[int, str] = {}
    for key, value in _map(node):
        number = value.get("polymorphic_id").whole(_MOST_ID)
        if value.find("polymorphic_name") is not None:
            kinds[number % FIRST] = value.get("polymorphic_name").text()
        kind = kinds.get(number % FIRST)
        if kind not in KINDS:
            place = value.find("polymorphic_name") or value.get("polymorphic_id")
            place.fail(f"one of {', '.join(KINDS)}")
        assert kind is not None
        yield key, read_camera(kind, value.get("ptr_wrapper").get("data"))


def _imported(
    path: Path,
    node: Node,
    views: dict[int, _View],
    cameras: dict[int, MvgCamera],
    poses: dict[int, Node],
    structure: dict[str, Any],
) -> Imported:
    posed = {
        key: view for key, view in views.items() if view.pose in poses and view.intrinsic in cameras
    }
    names = [view.name for view in posed.values()]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(
            f"{node.place}: views: expected each file once, found {brief(twice)} twice"
        )
    count = len(structure["ids"])
    if not all_differ(structure["ids"]):
        raise InputError(f"{node.place}: structure: expected each key once, found a key twice")
    point = np.repeat(np.arange(count, dtype=np.int32), structure["num_views"])
    image = _image_of(path, posed, views, structure, point)
    camera_ids = list(cameras)
    place = {key: index for index, key in enumerate(camera_ids)}
    image_camera = np.array([place[view.intrinsic] for view in posed.values()], np.int32)
    rotations = np.array(
        [poses[view.pose].get("rotation").numbers(3, 3) for view in posed.values()]
    ).reshape(-1, 3, 3)
    centers = np.array(
        [poses[view.pose].get("center").numbers(3) for view in posed.values()]
    ).reshape(-1, 3)
    nearest = checked_rotations(rotations, lambda k: poses[list(posed.values())[k].pose].place)
    models = [as_model(camera) for camera in cameras.values()]
    params = np.zeros((len(models), max((len(p) for _, p in models), default=1)))
    for row, (_, values) in enumerate(models):
        params[row, : len(values)] = values
    feature = structure["feature"]
    keys = unique_keys(image, feature.view(np.int32)) if len(feature) else None
    missing = len(views) - len(posed)
    notes = []
    if missing:
        is_or_are = "is" if missing == 1 else "are"
        notes.append(f"{plural(missing, 'view')} of {len(views)} {is_or_are} not registered.")
    targets = node.find("control_points")
    if targets is not None and targets.value:
        count = len(list(targets.entries()))
        notes.append(f"{plural(count, 'control point')} of the file are left out; use --gcp FILE.")
    if keys is None and len(image):
        notes.append("Features are not numbered in the file: an index occurs twice in a view.")

    projections = [partial(project, camera) for camera in cameras.values()]

    def projection(i: NDArray[np.int32], world: Array) -> Array:
        inside = np.einsum("nij,nj->ni", rotations[i], world - centers[i])
        return by_camera(projections, image_camera[i], inside)

    return Imported(
        path=path,
        fields={
            "cam_from_world": poses_of(nearest, -np.einsum("nij,nj->ni", nearest, centers)),
            "image_ids": np.array(list(posed), np.int64),
            "image_names": tuple(names),
            "image_camera": image_camera,
            "camera_ids": np.array(camera_ids, np.int64),
            "camera_models": tuple(model for model, _ in models),
            "camera_params": params,
            "camera_sizes": np.array(
                [(c.width, c.height) for c in cameras.values()], np.int64
            ).reshape(-1, 2),
            "points": structure["points"],
            "point_ids": structure["ids"],
            "observation_image": image,
            "observation_point": point,
            "observation_xy": structure["xy"],
            **({} if keys is None else {"observation_keypoint": keys}),
            "format": "openmvg",
        },
        colors=np.zeros((len(structure["ids"]), 3), np.uint8),
        project=projection,
        measured=structure["xy"],
        unit=np.ones(len(posed)),
        notes=notes,
        data={"root_path": node.value.get("root_path", "")},
    )


def _image_of(
    path: Path,
    posed: dict[int, _View],
    views: dict[int, _View],
    structure: dict[str, Any],
    point: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Return the index of the image of each observation.

    Raises:
        InputError: a view is unknown or has no pose.
    """
    known = np.array(sorted(posed), np.uint32)
    number = {key: index for index, key in enumerate(posed)}
    order = np.array([number[key] for key in known.tolist()] or [0], np.int32)
    seen = structure["view"]
    place = np.searchsorted(known, seen)
    np.minimum(place, max(len(known) - 1, 0), out=place)
    unknown = known[place] != seen if len(known) else np.ones(len(seen), bool)
    if unknown.any():
        first = int(np.argmax(unknown))
        view = int(seen[first])
        why = "has no pose or intrinsics" if view in views else "does not exist"
        landmark = structure["ids"][point[first]]
        raise InputError(
            f"{shown(path)}: structure: {landmark}: expected observations in views with a pose, "
            f"found one in view {view}, which {why}"
        )
    image: NDArray[np.int32] = order[place]
    return image
