"""Writer of recordings for the viewer of rerun (``.rrd``): points, images with their observations.

The entity ``/world/points`` has the points with colours; ``error`` (mean reprojection error in
pixels, -1 without observations) and ``num_views`` of each point are stored with them. The entity
``/world/images/NAME`` of each image is its pose, world_from_camera in COLMAP's axes (x right,
y down, z forward), and a pinhole camera with its focal lengths and principal point;
``keypoints`` below it has its observations in pixels. A panorama has its pose only. All is static:
a model has no timeline.

Source: https://rerun.io/docs/reference/types/archetypes (Points3D, Transform3D, Pinhole).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.base.optional_packages import require_package
from bundle.io.colmap import point_errors
from bundle.io.formats.written_tracks import colors_of, names_of
from bundle.model.lenses.exact_image import focal_and_center
from bundle.model.problem import Problem

_STRAIGHT = {"SIMPLE_PINHOLE", "PINHOLE"}


def check(problem: Problem, path: Path) -> None:  # noqa: ARG001
    """Raise the error that :func:`write` would raise.

    Raises:
        InputError: the package of rerun is not installed.
    """
    require_package("rerun", "bundle-adjust[rerun]", "format rerun")


def write(problem: Problem, path: Path) -> tuple[str, ...]:
    """Write a recording; return sentences on information that is lost."""
    import rerun  # large: an extra, for this format only

    recording = rerun.RecordingStream("bundle")
    recording.save(path)
    errors, behind = _core.reprojection_errors(problem, 0, "auto")
    point = problem.observation_point
    error = point_errors(errors, behind, point, problem.num_points)
    recording.log("world", rerun.ViewCoordinates.RDF, static=True)
    colors = colors_of(problem)
    recording.log(
        "world/points",
        rerun.Points3D(problem.points, colors=colors if colors.any() else None),
        rerun.AnyValues(error=error, num_views=np.bincount(point, minlength=problem.num_points)),
        static=True,
    )
    order = np.argsort(problem.observation_image, kind="stable")
    ends = np.searchsorted(problem.observation_image[order], np.arange(problem.num_images + 1))
    inverse = problem.cam_from_world[:, :4] * (-1, -1, -1, 1)
    centers = problem.projection_centers
    for image, name in enumerate(names_of(problem)):
        entity = rerun.new_entity_path(["world", "images", name])
        pose = rerun.Transform3D(translation=centers[image], quaternion=inverse[image])
        pinhole = _pinhole(problem, problem.image_camera[image])
        recording.log(entity, *[part for part in (pose, pinhole) if part is not None], static=True)
        if pinhole is not None:
            mine = order[ends[image] : ends[image + 1]]
            seen = rerun.Points2D(problem.observation_xy[mine])
            recording.log(f"{entity}/keypoints", seen, static=True)
    recording.flush()
    recording.disconnect()
    bent = sorted({problem.camera_models[camera] for camera in problem.image_camera} - _STRAIGHT)
    lenses = f" Distortion ({', '.join(bent)}) is left out." if bent else ""
    return (
        "Tracks and ids are left out, and coordinates have 7 digits: a recording of rerun is only "
        f"for its viewer.{lenses}",
    )


def _pinhole(problem: Problem, camera: int) -> Any:
    """Return the lens without its distortion; None for a panorama, which is not a pinhole."""
    import rerun

    model = problem.camera_models[camera]
    if model == "EQUIRECTANGULAR":
        return None
    fx, fy, cx, cy = focal_and_center(model, problem.camera_params[camera])
    size = problem.camera_sizes[camera]
    return rerun.Pinhole(
        focal_length=(fx, fy),
        principal_point=(cx, cy),
        resolution=size if size.all() else None,
        camera_xyz=rerun.ViewCoordinates.RDF,
    )
