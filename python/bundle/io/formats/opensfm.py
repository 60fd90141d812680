"""OpenSfM's reconstruction.json with tracks.csv, versions 0, 1 and 2.

A shot has a rotation vector and a translation cam_from_world, or, in a rig,
rig_camera_from_instance and instance_from_world, whose product is this pose. tracks.csv is in the
folder of reconstruction.json or in the folder above; its lines for shots of the reconstruction and
tracks with a point are the observations. Positions by GPS and the reference of the coordinates are
kept for the writer.

Source: https://opensfm.org/docs/dataset.html and opensfm/io.py.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.io.atomic import atomic_write as atomic
from bundle.io.formats.file_values import Node, parsed
from bundle.io.formats.imported_model import Imported, all_differ, by_camera, pixels, unique_keys
from bundle.io.formats.opensfm_cameras import (
    PRISM,
    RADIAL,
    SfmCamera,
    as_model,
    project,
    read_camera,
    rig_fields,
)
from bundle.io.formats.read_options import ReadOptions
from bundle.io.formats.written_tracks import (
    camera_error,
    check_names,
    colors_of,
    common_losses,
    keys_of,
    names_of,
    write_rows,
)
from bundle.model.cameras import camera_models
from bundle.model.lenses.exact_image import exact_params
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source
from bundle.model.rigid_motions import (
    quaternion_from_vector,
    quaternion_rotate,
    vector_from_quaternion,
)

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
    """Return the reconstruction with a number, or the only one of the file."""
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
    folders = (path.parent, path.parent.parent)
    listed = next((folder / TRACKS for folder in folders if (folder / TRACKS).is_file()), None)
    if listed is None:
        raise InputError(
            f"{shown(path)}: expected {TRACKS}, which has the observations, in its folder or the "
            "folder above, found no such file"
        )
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
        notes.append("Feature numbers of tracks.csv are not used: one occurs twice in an image.")
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


_SCALE = 0.004  # scale of a feature, relative to the image, where it is unknown


def check(problem: Problem, path: Path) -> None:  # noqa: ARG001
    """Raise the error that :func:`write` would raise.

    Raises:
        InputError: OpenSfM has no such camera, a size is unknown, or a name cannot be written.
    """
    for camera in range(problem.num_cameras):
        _camera(problem, camera)
    check_names(problem, TRACKS)


def write(problem: Problem, path: Path) -> tuple[str, ...]:
    """Write the files of an OpenSfM project into a folder; return sentences on what is lost."""
    content = _reconstruction(problem)
    with ExitStack() as stack:  # both files are complete before either replaces an old one
        stack.enter_context(atomic.made_folder(path))
        tracks = stack.enter_context(atomic.replace_file(path / TRACKS))
        model = stack.enter_context(atomic.replace_file(path / "reconstruction.json"))
        _write_tracks(problem, tracks)
        text = json.dumps([content], indent=1, ensure_ascii=False)
        model.write_text(text + "\n", "utf-8", errors="surrogateescape")
    keeps = ("rigs", "colors", "sharing", "names", "sizes", "point ids")
    lost = common_losses(problem, keeps=(*keeps, "ids"))
    source = imported_source(problem)
    if source is not None and _has_left(source.data):
        moved = "reference_lla and gps_position of the shots: the model was moved to another frame."
        lost = (*lost, moved)
    return lost


def _reconstruction(problem: Problem) -> dict[str, Any]:
    source = imported_source(problem)
    data = source.data if source is not None and "shots" in source.data else {}
    known = data.get("camera_names", [])
    cameras = [_camera_name(problem, camera, known) for camera in range(problem.num_cameras)]
    names = names_of(problem)
    shots = {
        name: {
            **_written_pose(problem.cam_from_world[image]),
            "camera": cameras[problem.image_camera[image]],
            **_metadata(data, name),
        }
        for image, name in enumerate(names)
    }
    colors = colors_of(problem).astype(float).tolist()
    points = {
        str(number): {"color": color, "coordinates": coordinates}
        for number, color, coordinates in zip(
            problem.point_ids.tolist(), colors, problem.points.tolist(), strict=True
        )
    }
    lla = data.get("reference_lla")
    return {
        "cameras": {name: _camera(problem, camera) for camera, name in enumerate(cameras)},
        "shots": shots,
        "points": points,
        "biases": {},
        **_rigs(problem, names),
        **({"reference_lla": lla} if lla else {}),
    }


def _metadata(data: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return the data of a shot as read, without its position if the frame has changed."""
    known = data.get("shots", {}).get(name, {})
    return {key: known[key] for key in known if key != "gps_position" or not _has_left(data)}


def _has_left(data: Mapping[str, Any]) -> bool:
    """Return True if the model was moved from the frame of its file to one without an origin."""
    return "moved_from" in data


def _camera_name(problem: Problem, camera: int, known: list[str]) -> str:
    """Return the name of the file for a camera that was read from it, otherwise one by its id."""
    camera_id = int(problem.camera_ids[camera])
    name = known[camera_id] if 0 <= camera_id < len(known) else f"camera {camera_id}"
    is_copy = known.count(name) > 1 and known.index(name) != camera_id
    return f"{name} {camera_id}" if is_copy else name


def _written_pose(pose: NDArray[np.float64]) -> dict[str, list[float]]:
    unit = pose[:4] / np.linalg.norm(pose[:4])
    rotation = vector_from_quaternion(unit[None])[0]
    return {"rotation": rotation.tolist(), "translation": pose[4:].tolist()}


def _rigs(problem: Problem, names: list[str]) -> dict[str, Any]:
    identity = {"rotation": [0.0, 0.0, 0.0], "translation": [0.0, 0.0, 0.0]}
    rig_cameras: dict[str, Any] = {}
    instances: dict[str, Any] = {}
    for image, name in enumerate(names):
        frame = int(problem.image_frame[image]) if problem.num_frames else -1
        if frame < 0:
            rig_cameras["rig_camera"] = identity
            pose = _written_pose(problem.cam_from_world[image])
            instances[name] = pose | {"rig_camera_ids": {name: "rig_camera"}}
            continue
        sensor = int(problem.image_sensor[image])
        rig = int(problem.frame_rig_ids[frame])
        own = f"rig {rig} camera {problem.camera_ids[problem.image_camera[image]]}"
        rig_cameras[own] = (
            identity if sensor < 0 else _written_pose(problem.sensor_from_rig[sensor])
        )
        key = f"frame {problem.frame_ids[frame]}"
        if key not in instances:
            instances[key] = _written_pose(problem.rig_from_world[frame]) | {"rig_camera_ids": {}}
        instances[key]["rig_camera_ids"][name] = own
    return {"rig_cameras": rig_cameras, "rig_instances": instances}


def _camera(problem: Problem, camera: int) -> dict[str, Any]:
    """Return a camera in OpenSfM's JSON."""
    model = problem.camera_models[camera]
    width, height = problem.camera_sizes[camera].tolist()
    if not width or not height:
        expected = "a known image size (--image-size W,H)"
        raise camera_error(problem, camera, "an OpenSfM project", expected)
    size = max(width, height)
    found = {"projection_type": "spherical", "width": width, "height": height}
    if model == "EQUIRECTANGULAR":
        return found
    params = problem.camera_params[camera, : len(camera_models()[model])]
    for target, kind in (("RADIAL", "perspective"), ("RADIAL_FISHEYE", "fisheye")):
        values = exact_params(model, params, target)
        if values is None or values[1] != width / 2 or values[2] != height / 2:
            continue
        k1, k2 = values[3:].tolist()
        return found | {"projection_type": kind, "focal": values[0] / size, "k1": k1, "k2": k2}
    for target, kind in (
        ("OPENCV", "brown"),
        ("FULL_OPENCV", "brown"),
        ("OPENCV_FISHEYE", "fisheye_opencv"),
    ):
        values = exact_params(model, params, target)
        if values is None or (target == "FULL_OPENCV" and values[9:].any()):
            continue
        fx, fy, cx, cy, *k = values.tolist()
        two = _focal_and_center([fx, fy, cx, cy], width, height)
        names = ("k1", "k2", "k3", "k4") if kind != "brown" else ("k1", "k2", "p1", "p2", "k3")
        terms = dict.fromkeys(names, 0.0) | dict(zip(names, k, strict=False))
        return found | {"projection_type": kind} | two | terms
    fisheye = _fisheye624(model, params, width, height)
    if fisheye is not None:
        return found | fisheye
    expected = (
        "a lens of OpenSfM (perspective, brown, fisheye, fisheye_opencv, fisheye62, fisheye624 or "
        "spherical)"
    )
    raise camera_error(problem, camera, "an OpenSfM project", expected)


def _focal_and_center(values: list[float], width: int, height: int) -> dict[str, float]:
    """Return the parameters of a lens with two focal lengths in units of the image."""
    fx, fy, cx, cy = values
    size = max(width, height)
    return {
        "focal_x": fx / size,
        "focal_y": fy / size,
        "c_x": (cx - width / 2) / size,
        "c_y": (cy - height / 2) / size,
    }


def _fisheye624(
    model: str, params: NDArray[np.float64], width: int, height: int
) -> dict[str, Any] | None:
    """Return fisheye62 or fisheye624 if one is the same lens; see ``opensfm_cameras``."""
    base, rest = params[:4].tolist(), params[4:].tolist()
    if model == "THIN_PRISM_FISHEYE":
        k1, k2, p1, p2, k3, k4, s0, s2 = rest
        radial, others = [k1, k2, k3, k4, 0.0, 0.0], [p1, p2, s0, 0.0, s2, 0.0]
    elif model == "RAD_TAN_THIN_PRISM_FISHEYE" and not (any(rest[:6]) and any(rest[6:])):
        radial, others = rest[:6], [rest[7], rest[6], *rest[8:]]
    else:
        return None
    is_62 = not any(others[2:])
    names = [*RADIAL, "p1", "p2", *(() if is_62 else PRISM)]
    terms = dict(zip(names, [*radial, *others], strict=False))
    kind = "fisheye62" if is_62 else "fisheye624"
    return {"projection_type": kind} | _focal_and_center(base, width, height) | terms


def _write_tracks(problem: Problem, path: Path) -> None:
    """Write tracks.csv, version 2, image by image."""
    names = names_of(problem)
    image = problem.observation_image
    order = np.argsort(image, kind="stable")
    ends = np.searchsorted(image[order], np.arange(problem.num_images + 1))
    sizes = problem.camera_sizes[problem.image_camera]
    colors, keys, scales = colors_of(problem), keys_of(problem), _scales(problem)
    with path.open("w", encoding="utf-8", errors="surrogateescape") as file:
        file.write("OPENSFM_TRACKS_VERSION_v2\n")
        for row, name in enumerate(names):
            mine = order[ends[row] : ends[row + 1]]
            point = problem.observation_point[mine]
            xy = (problem.observation_xy[mine] - sizes[row] / 2) / sizes[row].max(initial=1)
            columns = np.column_stack(
                [problem.point_ids[point], keys[mine], xy, scales[mine], colors[point]]
            )
            literal = name.replace("%", "%%")
            template = f"{literal}\t%d\t%d\t%r\t%r\t%r\t%d\t%d\t%d\t-1\t-1\n"
            write_rows(file, template, columns)


def _scales(problem: Problem) -> NDArray[np.float64]:
    """Return the scale of each feature as it was read, if it was."""
    scales = np.full(problem.num_observations, _SCALE)
    source = imported_source(problem)
    if source is None or "scale" not in source.data:
        return scales
    image, key, known = source.data["scale"]
    if not len(known) or not (problem.observation_keypoint >= 0).all():
        return scales
    table = image.astype(np.int64) << 32 | key
    order = np.argsort(table)
    ids = problem.image_ids[problem.observation_image]
    wanted = ids << 32 | problem.observation_keypoint
    place = np.minimum(np.searchsorted(table[order], wanted), len(order) - 1)
    found = table[order[place]] == wanted
    scales[found] = known[order[place[found]]]
    return scales
