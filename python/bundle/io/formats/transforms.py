"""Writer of nerfstudio's and instant-ngp's transforms.json: cameras only.

``transform_matrix`` is world_from_camera with OpenGL's axes: x right, y up, z back. With a pose
(R, t) cam_from_world of COLMAP it is [R^T diag(1, -1, -1), -R^T t]. Intrinsics are in pixels, in
COLMAP's convention; they are at the top if all images share them, otherwise in each frame. The
world's axes are those of the model.

Source: https://docs.nerf.studio/quickstart/data_conventions.html
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from bundle.io.formats.written_tracks import camera_error, names_of
from bundle.model.cameras import camera_models
from bundle.model.lenses.exact_image import exact_params
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

_OPENGL = np.array([1.0, -1.0, -1.0])
_TARGETS = ("OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE")


def check(problem: Problem, path: Path) -> None:  # noqa: ARG001
    """Raise the error that :func:`write` would raise.

    Raises:
        InputError: nerfstudio has no such camera.
    """
    for camera in range(problem.num_cameras):
        _camera(problem, camera)


def write(problem: Problem, path: Path) -> tuple[str, ...]:
    """Write transforms.json; return sentences on information that is lost."""
    cameras = [_camera(problem, camera) for camera in range(problem.num_cameras)]
    used = sorted(set(problem.image_camera.tolist()))
    shared = cameras[used[0]] if len(used) == 1 else {}
    kinds = {cameras[camera]["camera_model"] for camera in used}
    if len(kinds) == 1:
        shared = {"camera_model": kinds.pop(), **shared}
    pose = problem.cam_from_world
    unit = pose[:, :4] / np.linalg.norm(pose[:, :4], axis=1)[:, None]
    matrices = np.tile(np.eye(4), (problem.num_images, 1, 1))
    matrices[:, :3, :3] = rotation_matrices(unit).transpose(0, 2, 1) * _OPENGL
    matrices[:, :3, 3] = problem.projection_centers
    frames = [
        {
            "file_path": name,
            **{
                key: value
                for key, value in cameras[problem.image_camera[image]].items()
                if shared.get(key) != value
            },
            "transform_matrix": matrices[image].tolist(),
            "colmap_im_id": int(problem.image_ids[image]),
        }
        for image, name in enumerate(names_of(problem))
    ]
    text = json.dumps({**shared, "frames": frames}, indent=1, ensure_ascii=False)
    path.write_text(text + "\n", "utf-8", errors="surrogateescape")
    return (
        f"Points ({problem.num_points}) and observations ({problem.num_observations}) are left "
        "out: transforms.json has cameras only. --format ply writes the points.",
    )


def _camera(problem: Problem, camera: int) -> dict[str, Any]:
    model = problem.camera_models[camera]
    width, height = problem.camera_sizes[camera].tolist()
    if model == "EQUIRECTANGULAR":
        size = {"w": width, "h": height, "fl_x": 1.0, "fl_y": 1.0, "cx": width / 2}
        return {"camera_model": "EQUIRECTANGULAR", **size, "cy": height / 2}
    params = problem.camera_params[camera, : len(camera_models()[model])]
    for target in _TARGETS:
        found = exact_params(model, params, target)
        if found is None or (target == "FULL_OPENCV" and found[9:].any()):
            continue
        fx, fy, cx, cy, *k = found.tolist()
        base = {"w": width, "h": height, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
        is_fisheye = target == "OPENCV_FISHEYE"
        names = ["k1", "k2", "k3", "k4"] if is_fisheye else ["k1", "k2", "p1", "p2", "k3"]
        kind = target if is_fisheye else "OPENCV"
        return {"camera_model": kind, **base, **dict(zip(names, k, strict=False))}
    expected = "a lens of nerfstudio (OPENCV with k3, or OPENCV_FISHEYE)"
    raise camera_error(problem, camera, "transforms.json", expected)
