"""Writer of OpenMVG's sfm_data.json; ``openmvg`` and ``openmvg_cameras`` derive the conventions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.io.formats.openmvg import FIRST, KINDS
from bundle.io.formats.written_tracks import camera_error, common_losses, keys_of, names_of
from bundle.model.lenses.exact_image import exact_params
from bundle.model.problem import Problem
from bundle.model.pycolmap.problem_source import imported_source
from bundle.model.rigid_motions import rotation_matrices

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
    _intrinsics(problem)


def write(problem: Problem, path: Path) -> tuple[str, ...]:
    """Write an OpenMVG scene; return sentences on information that is lost."""
    intrinsics = _intrinsics(problem)
    pose = problem.cam_from_world
    unit = pose[:, :4] / np.linalg.norm(pose[:, :4], axis=1)[:, None]
    rotations, centers = rotation_matrices(unit).tolist(), problem.projection_centers.tolist()
    ids = problem.image_ids.tolist()
    source = imported_source(problem)
    root = "" if source is None else source.data.get("root_path", "")
    views = [
        _wrapped(row + len(intrinsics), _view(problem, row, name, image_id), 2**30, image_id)
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


def _view(problem: Problem, row: int, name: str, image_id: int) -> dict[str, Any]:
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


def _intrinsics(problem: Problem) -> list[dict[str, Any]]:
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
