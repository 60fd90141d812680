"""OpenSfM's reconstruction.json with tracks.csv, versions 0, 1 and 2.

A shot has a rotation vector and a translation cam_from_world, or, in a rig, the poses
rig_camera_from_instance and instance_from_world, whose product they are. tracks.csv is in the
folder of reconstruction.json or in the folder above; its lines for shots of the reconstruction and
tracks with a point are the observations. Positions by GPS and the reference of the coordinates are
kept for the writer.

Source: https://opensfm.org/docs/dataset.html and opensfm/io.py.
"""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.io.formats.imported_model import (
    Imported,
    all_differ,
    by_camera,
    pixels,
    unique_keys,
)
from bundle.io.formats.json_fields import Node, parsed
from bundle.io.formats.opensfm_cameras import SfmCamera, as_model, project, read_camera
from bundle.io.formats.opensfm_rigs import rig_fields
from bundle.io.formats.read_options import ReadOptions
from bundle.model.problem import Problem
from bundle.model.rotations import quaternion_from_vector, quaternion_rotate

TRACKS = "tracks.csv"
Array = NDArray[np.float64]


def read(path: Path, options: ReadOptions) -> Problem:
    """Read an OpenSfM reconstruction.

    Raises:
        InputError: a file violates its format, or the file has several reconstructions and none is
            chosen.
        OSError: a file cannot be read.
    """
    table = _core.read_opensfm(path, max(options.reconstruction or 0, 0), options.progress)
    node = chosen_reconstruction(parsed(table["rest"], path), options.reconstruction)
    cameras = {name: read_camera(camera) for name, camera in node.get("cameras").items()}
    shots = dict(node.get("shots").items())
    _check_names(node, table)
    tracks = _tracks(path, shots, table, options)
    return _imported(path, node, cameras, shots, table, tracks).problem()


def chosen_reconstruction(node: Node, number: int | None) -> Node:
    """Return the reconstruction with a number, or the only one of the file.

    Raises:
        InputError: the file has no reconstruction, or several and none is chosen.
    """
    found = list(node.entries())
    if not found:
        raise InputError(f"{node.place}: expected a reconstruction, found an empty list")
    if number is not None:
        if not 0 <= number < len(found):
            raise InputError(
                f"{node.place}: expected --reconstruction from 0 to {len(found) - 1}, "
                f"found {number}"
            )
        return found[number]
    if len(found) > 1:
        sizes = ", ".join(str(len(list(one.get("shots").items()))) for one in found)
        raise InputError(
            f"{node.place}: expected one reconstruction, found {len(found)} (of {sizes} images); "
            f"choose by --reconstruction 0 to {len(found) - 1}"
        )
    return found[0]


def _tracks(
    path: Path, shots: dict[str, Node], table: dict[str, Any], options: ReadOptions
) -> dict[str, Any]:
    """Return the observations of the points; a reconstruction without points needs no file."""
    if not len(table["ends"]):
        empty = np.empty(0, np.int32)
        no_pixels: dict[str, Any] = {"xy": np.empty((0, 2)), "scale": np.empty(0)}
        return {"image": empty, "point": empty, "key": empty, **no_pixels}
    listed = _tracks_file(path)
    tracks = _core.read_tracks_csv(
        listed,
        [name.encode(errors="surrogateescape") for name in shots],
        table["names"],
        table["ends"],
        options.progress,
    )
    if shots and not len(tracks["image"]):
        raise InputError(
            f"{shown(listed)}: expected observations of the {plural(len(shots), 'shot')} of "
            f"{shown(path)}, found 0"
        )
    return tracks


def _tracks_file(path: Path) -> Path:
    folders = (path.parent, path.parent.parent)
    found = next((folder / TRACKS for folder in folders if (folder / TRACKS).is_file()), None)
    if found is None:
        raise InputError(
            f"{shown(path)}: expected {TRACKS}, which has the observations, in its folder or the "
            "folder above, found no such file"
        )
    return found


def _imported(
    path: Path,
    node: Node,
    cameras: dict[str, SfmCamera],
    shots: dict[str, Node],
    table: dict[str, Any],
    tracks: dict[str, Any],
) -> Imported:
    names = list(cameras)
    models = [
        as_model(camera, f"{node.place}: cameras: {name}") for name, camera in cameras.items()
    ]
    image_camera = np.array([_camera_of(shot, names) for shot in shots.values()], np.int32)
    poses = np.array([_pose(shot) for shot in shots.values()]).reshape(-1, 7)
    rigs = rig_fields(node, list(shots), image_camera, poses)
    image, xy, key = tracks["image"], tracks["xy"], unique_keys(tracks["image"], tracks["key"])
    unit = np.array([cameras[names[camera]].size for camera in image_camera], float)
    sizes = np.array([(c.width, c.height) for c in cameras.values()], np.int64).reshape(-1, 2)
    notes = list(rigs.notes)
    for kind in dict.fromkeys(camera.type for camera in cameras.values()):
        fitted = [
            model
            for model, camera in zip(models, cameras.values(), strict=True)
            if model.error and camera.type == kind
        ]
        if fitted:
            notes.append(
                f"{fitted[0].model} was fitted to "
                f"{plural(len(fitted), f'{kind} lens', f'{kind} lenses')}; the largest error is "
                f"{max(model.error for model in fitted):.2g} px."
            )
    if key is None and len(image):
        notes.append("Features are not numbered in tracks.csv: an index occurs twice in an image.")
    width = max((len(model.params) for model in models), default=1)
    params = np.zeros((len(models), width))
    for row, model in enumerate(models):
        params[row, : len(model.params)] = model.params

    projections = [partial(project, camera) for camera in cameras.values()]

    def projection(i: NDArray[np.int32], world: Array) -> Array:
        inside = quaternion_rotate(poses[i, :4], world) + poses[i, 4:]
        return by_camera(projections, image_camera[i], inside)

    center = sizes[image_camera] / 2
    camera_of_model = rigs.camera  # rigs with a shared lens have a copy of it per sensor
    return Imported(
        path=path,
        fields={
            "image_names": tuple(shots),
            "image_camera": rigs.image_camera,
            "camera_models": tuple(models[row].model for row in camera_of_model),
            "camera_params": params[camera_of_model],
            "camera_sizes": sizes[camera_of_model],
            "points": table["points"],
            **_point_ids(table["ids"]),
            "observation_image": image,
            "observation_point": tracks["point"],
            "observation_xy": pixels(xy, image, np.column_stack([unit, unit]), center),
            **({} if key is None else {"observation_keypoint": key}),
            "format": "opensfm",
            **rigs.fields,
        },
        colors=table["colors"],
        project=projection,
        measured=xy,
        unit=unit,
        fit_error=max((model.error for model in models), default=0.0),
        notes=notes,
        data=_kept(node, [names[row] for row in camera_of_model], shots, tracks),
    )


def _kept(
    node: Node, cameras: list[str], shots: dict[str, Node], tracks: dict[str, Any]
) -> dict[str, Any]:
    """Return what the writer uses again: names of cameras, GPS, reference, scales."""
    gps = {
        name: {key: shot.value[key] for key in _OF_SHOT if key in shot.value}
        for name, shot in shots.items()
    }
    reference = node.find("reference_lla")
    return {
        "camera_names": cameras,
        "shots": gps,
        "reference_lla": None if reference is None else reference.value,
        "scale": (tracks["image"], tracks["key"], tracks["scale"]),
    }


_OF_SHOT = ("orientation", "capture_time", "gps_dop", "gps_position", "compass", "skey")


def _camera_of(shot: Node, names: list[str]) -> int:
    name = shot.get("camera").text()
    if name not in names:
        shot.get("camera").fail("one of the cameras")
    return names.index(name)


def _pose(shot: Node) -> Array:
    rotation, translation = (shot.get(name).numbers(3) for name in ("rotation", "translation"))
    if np.abs(rotation).max() > 1e6:
        shot.get("rotation").fail("a rotation vector in radians")
    return np.concatenate([quaternion_from_vector(rotation[None])[0], translation])


def _check_names(node: Node, table: dict[str, Any]) -> None:
    """Refuse points of the same name."""
    ids, ends = table["ids"], table["ends"].tolist()
    if len(ids) and all_differ(ids):
        return
    names = [table["names"][i:j] for i, j in zip([0, *ends], ends, strict=False)]
    if len(set(names)) < len(names):
        twice = next(name for name, count in Counter(names).items() if count > 1)
        found = brief(twice.decode(errors="replace"))
        raise InputError(f"{node.place}: points: expected each point once, found {found} twice")


def _point_ids(ids: NDArray[np.int64]) -> dict[str, NDArray[np.int64]]:
    """Return the names as ids if they are different whole numbers, otherwise nothing."""
    return {"point_ids": ids} if len(ids) and all_differ(ids) else {}
