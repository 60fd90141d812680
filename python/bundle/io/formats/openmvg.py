"""OpenMVG's scenes, sfm_data.json, and its intrinsics as camera models.

A view names its photograph, intrinsics and pose; a pose is a rotation R and a centre C, and a world
point X is R (X - C) in the camera frame, x right, y down, z forward. Pixels are kept as they are in
the file, as OpenMVG's own export to COLMAP does. The file is cereal's JSON: an entry of a map is
``{"key": k, "value": v}``, and the name of a polymorphic type is written at its first occurrence
only, with its number + 2^31.

Source: openMVG/sfm/sfm_data_io_cereal.cpp, https://openmvg.readthedocs.io.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import check_distinct
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, shown
from bundle.io.formats.file_values import Node, parsed
from bundle.io.formats.imported_model import (
    Imported,
    all_differ,
    by_camera,
    checked_rotations,
    poses_of,
    unique_keys,
)
from bundle.io.formats.read_options import ReadOptions
from bundle.io.formats.written_tracks import camera_error, common_losses, keys_of, names_of
from bundle.model.lenses.exact_image import exact_params
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source
from bundle.model.rigid_motions import rotation_matrices

Array = NDArray[np.float64]
FIRST = 1 << 31  # added to the number of a polymorphic type where its name is written
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
    """Yield keys and values of a map."""
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
    check_distinct(f"{node.place}: views: expected each file once", names)
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
        notes.append("Feature numbers are not used: one occurs twice in a view.")

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
    """Return the index of the image of each observation."""
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


# OpenMVG's intrinsics as camera models.
#
# With p = (X, Y) / Z, r2 = p.p, the focal length f and the principal point c, a pixel is f d(p) +
# c:
#
#     pinhole                  p                                              (SIMPLE_PINHOLE)
#     pinhole_radial_k1        p (1 + k1 r2)                                  (SIMPLE_RADIAL)
#     pinhole_radial_k3        p (1 + k1 r2 + k2 r4 + k3 r6)                  (RADIAL, FULL_OPENCV)
#     pinhole_brown_t2         the same + (2 t1 x y + t2 (r2 + 2 x^2),
#                                          t1 (r2 + 2 y^2) + 2 t2 x y)        (OPENCV, FULL_OPENCV)
#     fisheye                  p theta (1 + k1 theta^2 + ... + k4 theta^8) / r, theta = atan(r)
#                                                                             (OPENCV_FISHEYE)
#     spherical                size (atan2(X, Z), atan2(Y, |(X, Z)|)) / 2 pi + (w, h) / 2, with
#                              size = max(w, h)                               (EQUIRECTANGULAR)
#
# Source: openMVG/cameras/Camera_Pinhole*.hpp, Camera_Spherical.hpp.


KINDS = {
    "pinhole": ("", 0),
    "pinhole_radial_k1": ("disto_k1", 1),
    "pinhole_radial_k3": ("disto_k3", 3),
    "pinhole_brown_t2": ("disto_t2", 5),
    "fisheye": ("fisheye", 4),
    "spherical": ("", 0),
}
"""Member with the distortion, and the number of its coefficients, by polymorphic_name."""


@dataclass(frozen=True)
class MvgCamera:
    """Intrinsics of OpenMVG."""

    kind: str
    width: int
    height: int
    focal: float
    center: tuple[float, float]
    distortion: tuple[float, ...]


def read_camera(kind: str, data: Node) -> MvgCamera:
    """Read intrinsics from their ``data``."""
    base = data.find("value0") or data
    width, height = (base.get(name).whole() for name in ("width", "height"))
    if kind == "spherical":
        if not width or width != 2 * height:
            base.fail("a spherical image twice as wide as high")
        return MvgCamera(kind, width, height, 1.0, (width / 2, height / 2), ())
    focal = base.get("focal_length").number()
    if focal <= 0:
        base.get("focal_length").fail("a number above 0")
    cx, cy = base.get("principal_point").numbers(2).tolist()
    member, count = KINDS[kind]
    distortion = tuple(data.get(member).numbers(count).tolist()) if count else ()
    return MvgCamera(kind, width, height, focal, (cx, cy), distortion)


def as_model(camera: MvgCamera) -> tuple[str, list[float]]:
    """Return name and parameters of the camera model."""
    one = [camera.focal, *camera.center]
    two = [camera.focal, *one]
    k = camera.distortion
    if camera.kind == "pinhole":
        return "SIMPLE_PINHOLE", one
    if camera.kind == "pinhole_radial_k1":
        return "SIMPLE_RADIAL", [*one, *k]
    if camera.kind == "fisheye":
        return "OPENCV_FISHEYE", [*two, *k]
    if camera.kind == "spherical":
        return "EQUIRECTANGULAR", [camera.width, camera.height]
    t1, t2 = k[3:] if len(k) == 5 else (0.0, 0.0)
    if k[2]:
        return "FULL_OPENCV", [*two, k[0], k[1], t1, t2, k[2], 0.0, 0.0, 0.0]
    return ("OPENCV", [*two, k[0], k[1], t1, t2]) if len(k) == 5 else ("RADIAL", [*one, *k[:2]])


def project(camera: MvgCamera, inside: Array) -> Array:
    """Project points (n, 3) in the camera frame by OpenMVG's formula, in pixels."""
    x, y, z = inside.T
    if camera.kind == "spherical":
        turn = np.column_stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))])
        size = max(camera.width, camera.height)
        spherical: Array = turn * size / (2 * np.pi) + np.array(camera.center)
        return spherical
    p = inside[:, :2] / z[:, None]
    r2 = (p * p).sum(axis=1)
    if camera.kind == "fisheye":
        k = camera.distortion
        radius = np.sqrt(r2)
        t = np.arctan(radius)
        s = t * t
        bent = t * (1 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))))
        p = p * np.divide(bent, radius, out=np.ones_like(bent), where=radius > 0)[:, None]
    elif camera.distortion:
        k1, k2, k3 = (*camera.distortion, 0.0, 0.0)[:3]
        u, v = p.T
        p = p * (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))[:, None]
        if camera.kind == "pinhole_brown_t2":
            t1, t2 = camera.distortion[3:]
            p[:, 0] += 2 * t1 * u * v + t2 * (r2 + 2 * u * u)
            p[:, 1] += t1 * (r2 + 2 * v * v) + 2 * t2 * u * v
    pixels: Array = camera.focal * p + np.array(camera.center)
    return pixels


# Writer of sfm_data.json.

_BLOCK = 1 << 14
_TARGETS = {
    "SIMPLE_PINHOLE": "pinhole",
    "SIMPLE_RADIAL": "pinhole_radial_k1",
    "RADIAL": "pinhole_radial_k3",
    "OPENCV": "pinhole_brown_t2",
    "FULL_OPENCV": "pinhole_brown_t2",
    "OPENCV_FISHEYE": "fisheye",
}
"""Types by the camera model with their coefficients, the smallest first."""


def check(problem: Problem, path: Path) -> None:  # noqa: ARG001
    """Raise the error that :func:`write` would raise.

    Raises:
        InputError: OpenMVG has no such camera.
    """
    _intrinsic_nodes(problem)


def write(problem: Problem, path: Path) -> tuple[str, ...]:
    """Write an OpenMVG scene; return sentences on information that is lost."""
    intrinsics = _intrinsic_nodes(problem)
    pose = problem.cam_from_world
    unit = pose[:, :4] / np.linalg.norm(pose[:, :4], axis=1)[:, None]
    rotations, centers = rotation_matrices(unit).tolist(), problem.projection_centers.tolist()
    ids = problem.image_ids.tolist()
    source = imported_source(problem)
    root = "" if source is None else source.data.get("root_path", "")
    views = [
        _wrapped(row + len(intrinsics), _view_node(problem, row, name, image_id), 2**30, image_id)
        for row, (name, image_id) in enumerate(zip(names_of(problem), ids, strict=True))
    ]
    extrinsics = [
        {"key": image_id, "value": {"rotation": rotation, "center": center}}
        for image_id, rotation, center in zip(ids, rotations, centers, strict=True)
    ]
    head = {
        "sfm_data_version": "0.3",
        "root_path": root,
        "views": views,
        "intrinsics": intrinsics,
        "extrinsics": extrinsics,
    }
    with path.open("w", encoding="utf-8", errors="surrogateescape") as file:
        file.write(json.dumps(head, indent=1, ensure_ascii=False)[:-2] + ',\n "structure": [')
        order = np.argsort(problem.observation_point, kind="stable")
        counts = np.bincount(problem.observation_point, minlength=problem.num_points)
        ends = np.concatenate([[0], np.cumsum(counts)])
        columns = (problem.image_ids[problem.observation_image], keys_of(problem))
        for begin in range(0, problem.num_points, _BLOCK):
            end = min(begin + _BLOCK, problem.num_points)
            rows = order[ends[begin] : ends[end]]
            file.write("" if begin == 0 else ",")
            file.write(_landmarks(problem, columns, rows, ends[begin : end + 1], begin))
        file.write('],\n "control_points": []\n}\n')
    keeps = ("ids", "sharing", "names", "sizes")
    return common_losses(problem, keeps=keeps)


def _landmarks(
    problem: Problem,
    columns: tuple[NDArray[np.int64], NDArray[np.int64]],
    rows: NDArray[np.intp],
    ends: NDArray[np.int64],
    begin: int,
) -> str:
    """Return the text of a block of points, from the JSON of its observations."""
    views, keys = (column[rows].tolist() for column in columns)
    seen = [
        f'{{"key": {view}, "value": {{"id_feat": {key}, "x": [{x!r}, {y!r}]}}}}'
        for view, key, (x, y) in zip(
            views, keys, problem.observation_xy[rows].tolist(), strict=True
        )
    ]
    ids = problem.point_ids[begin : begin + len(ends) - 1].tolist()
    points = problem.points[begin : begin + len(ends) - 1].tolist()
    places = (ends - ends[0]).tolist()
    texts = []
    for number, point, first, last in zip(ids, points, places[:-1], places[1:], strict=True):
        mine = ", ".join(seen[first:last])
        value = f'{{"X": {point}, "observations": [{mine}]}}'
        texts.append(f'\n  {{"key": {number}, "value": {value}}}')
    return ",".join(texts)


def _view_node(problem: Problem, row: int, name: str, image_id: int) -> dict[str, Any]:
    camera = problem.image_camera[row]
    width, height = problem.camera_sizes[camera].tolist()
    return {
        "local_path": "",
        "filename": name,
        "width": width,
        "height": height,
        "id_view": image_id,
        "id_intrinsic": int(problem.camera_ids[camera]),
        "id_pose": image_id,
    }


def _wrapped(number: int, data: dict[str, Any], kind: int, key: int) -> dict[str, Any]:
    pointer = {"id": FIRST + number + 1, "data": data}
    return {"key": key, "value": {"polymorphic_id": kind, "ptr_wrapper": pointer}}


def _intrinsic_nodes(problem: Problem) -> list[dict[str, Any]]:
    """Return the intrinsics."""
    entries: list[dict[str, Any]] = []
    kinds: dict[str, int] = {}
    for camera, camera_id in enumerate(problem.camera_ids.tolist()):
        kind, distortion, base = _camera(problem, camera)
        member = KINDS[kind][0]
        data = base | ({member: distortion} if member else {})
        first = kind not in kinds
        number = kinds.setdefault(kind, len(kinds) + 1)
        entry = _wrapped(camera, data, number + (FIRST if first else 0), camera_id)
        if first:
            entry["value"] = {"polymorphic_name": kind} | entry["value"]
        entries.append(entry)
    return entries


def _camera(problem: Problem, camera: int) -> tuple[str, list[float], dict[str, Any]]:
    model = problem.camera_models[camera]
    width, height = problem.camera_sizes[camera].tolist()
    size = {"width": width, "height": height}
    if model == "EQUIRECTANGULAR":
        return "spherical", [], size
    params = _trimmed(problem, camera)
    targets = [model] if model in _TARGETS else []
    for target in (*targets, *_TARGETS):
        found = exact_params(model, params, target)
        if found is None:
            continue
        values = found.tolist()
        if target.startswith(("OPENCV", "FULL")):
            if values[0] != values[1]:
                continue
            values = values[1:]
        k = values[3:]
        if target == "RADIAL":
            k = [*k, 0.0]
        if target in ("OPENCV", "FULL_OPENCV"):
            if any(k[5:]):
                continue
            k = [k[0], k[1], k[4] if len(k) > 4 else 0.0, k[2], k[3]]
        base = {"focal_length": values[0], "principal_point": values[1:3]}
        return _TARGETS[target], k, size | base
    expected = "fx = fy and a lens of OpenMVG (up to k3 and tangential terms, or fisheye)"
    raise camera_error(problem, camera, "an OpenMVG file", expected)


def _trimmed(problem: Problem, camera: int) -> NDArray[np.float64]:
    """Return the parameters of a camera without padding."""
    from bundle.model.cameras import camera_models

    count = len(camera_models()[problem.camera_models[camera]])
    return problem.camera_params[camera, :count]
