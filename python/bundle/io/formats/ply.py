"""Writer of PLY files for viewers: points with colours and errors, and frusta of the cameras.

Binary, little endian. A point has x, y, z, its colour, its mean reprojection error in pixels (-1 if
it has no observation) and the number of its views. The frusta are edges between five more vertices
per image: the projection centre and the four corners of the image, with 0 views.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.io.colmap import point_errors
from bundle.io.formats.written_tracks import colors_of
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotate, rotation_matrices

DEPTH = 0.05  # length of a frustum, relative to the median distance of points from the images

_VERTEX = np.dtype(
    [
        *((axis, "<f4") for axis in "xyz"),
        *((color, "u1") for color in ("red", "green", "blue")),
        ("error", "<f4"),
        ("num_views", "<f4"),
    ]
)
_EDGE = np.dtype([("vertex1", "<i4"), ("vertex2", "<i4")])
_PAIRS = np.array([(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)])
_TYPES = {"<f4": "float", "|u1": "uchar", "<i4": "int"}
_ORANGE = (255, 128, 0)


def write(problem: Problem, path: Path) -> tuple[str, ...]:
    """Write a point cloud with frusta; return sentences on information that is lost."""
    corners = _frusta(problem)
    vertices = np.zeros(problem.num_points + len(corners), _VERTEX)
    points, frusta = vertices[: problem.num_points], vertices[problem.num_points :]
    errors, behind = _core.reprojection_errors(problem, 0, "auto")
    point = problem.observation_point
    points["error"] = np.minimum(
        point_errors(errors, behind, point, problem.num_points), np.finfo(np.float32).max
    )
    points["num_views"] = np.bincount(point, minlength=problem.num_points)
    for part, xyz in ((points, problem.points), (frusta, corners)):
        for column, axis in enumerate("xyz"):
            part[axis] = xyz[:, column]
    for column, color in enumerate(("red", "green", "blue")):
        points[color] = colors_of(problem)[:, column]
        frusta[color] = _ORANGE[column]
    pairs = problem.num_points + 5 * np.arange(problem.num_images)[:, None, None] + _PAIRS
    edges = np.zeros(8 * problem.num_images, _EDGE)
    edges["vertex1"], edges["vertex2"] = pairs.reshape(-1, 2).T
    lines = ["ply", "format binary_little_endian 1.0", f"comment {problem.num_points} points"]
    for name, array in (("vertex", vertices), ("edge", edges)):
        lines.append(f"element {name} {len(array)}")
        fields = (array.dtype.fields or {}).items()
        lines += [f"property {_TYPES[kind.str]} {field}" for field, (kind, *_) in fields]
    with path.open("wb") as file:
        file.write(("\n".join(lines) + "\nend_header\n").encode())
        file.write(vertices.tobytes() + edges.tobytes())
    return (
        f"Observations ({problem.num_observations}), lenses and names are left out, and "
        "coordinates have 7 digits: a PLY file is only for viewers.",
    )


def _frusta(problem: Problem) -> NDArray[np.float64]:
    """Return (5 num_images, 3) world coordinates: centre and corners of each image."""
    pose = problem.cam_from_world
    unit = pose[:, :4] / np.maximum(np.linalg.norm(pose[:, :4], axis=1)[:, None], 1e-300)
    to_world = rotation_matrices(unit).transpose(0, 2, 1)
    centers = problem.projection_centers
    image, point = problem.observation_image, problem.observation_point
    step = max(1, len(image) // 100_000)
    far = np.linalg.norm(problem.points[point[::step]] - centers[image[::step]], axis=1)
    depth = DEPTH * float(np.median(far)) if len(far) else 1.0
    params = problem.camera_params[problem.image_camera]
    sizes = problem.camera_sizes[problem.image_camera].astype(float)
    is_known = sizes.all(axis=1)
    sizes[~is_known] = (1.5, 1.0)
    has_focal = np.array([m != "EQUIRECTANGULAR" for m in problem.camera_models])
    focal = np.where(has_focal[problem.image_camera], params[:, 0], sizes.max(axis=1))
    focal = np.where(is_known, focal, 1.5)
    half = sizes / (2 * focal[:, None])
    signs = np.array([(0, 0, 0), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)], float)
    inside = depth * signs[None] * np.column_stack([half, np.ones(len(half))])[:, None]
    world: NDArray[np.float64] = rotate(to_world[:, None], inside) + centers[:, None]
    return world.reshape(-1, 3)
