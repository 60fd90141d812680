"""Writer of NVM files; ``nvm`` derives the conventions.

The distortion r of NVM acts on the measurement. A lens of COLMAP with distortion is fitted: over
radii s of the image in focal lengths, r minimises the sum of (s (1 + r s^2) - t)^2, where t is the
tangent of the ray whose image is s. A lens that was read from NVM and has not changed keeps its r.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.io import bal
from bundle.io.formats.bundler_writer import moved_centers
from bundle.io.formats.nvm import SPACE
from bundle.io.formats.written_tracks import (
    check_names,
    colors_of,
    common_losses,
    keys_of,
    names_of,
    write_tracks,
)
from bundle.model.problem import Problem
from bundle.model.pycolmap.imported_source import imported_source

_NUM_RADII = 64


MOST_ERROR = 2.0
"""Largest error of a fitted distortion in pixels; lenses with a larger one are refused."""


def check(problem: Problem, path: Path) -> None:  # noqa: ARG001
    """Raise the error that :func:`write` would raise.

    Raises:
        InputError: a camera or a name cannot be written.
    """
    _, error = _distortion(problem, bal.radial_params(problem, "an NVM file"))
    if error > MOST_ERROR:
        raise InputError(
            "camera_params: an NVM file cannot hold them: expected lenses that its one coefficient "
            f"of distortion fits to {MOST_ERROR:g} px, found an error of {error:.3g} px"
        )
    check_names(problem, "an NVM file", "\n\r\t" + SPACE)


def write(problem: Problem, path: Path) -> tuple[str, ...]:
    """Write an NVM file; return sentences on information that is lost."""
    params = bal.radial_params(problem, "an NVM file")
    distortion, error = _distortion(problem, params)
    pose = problem.cam_from_world
    q = pose[:, [3, 0, 1, 2]] / np.linalg.norm(pose[:, :4], axis=1)[:, None]
    rows = np.column_stack([params[:, 0], q, problem.projection_centers, distortion])
    image = problem.observation_image
    xy = problem.observation_xy - params[image, 1:3]
    with path.open("w", encoding="utf-8", errors="surrogateescape") as file:
        file.write(f"NVM_V3 \n\n{problem.num_images}\n")
        for name, row in zip(names_of(problem), rows.tolist(), strict=True):
            file.write(name.replace(" ", SPACE) + "\t" + "%r " * 9 % tuple(row) + "0\n")
        file.write(f"\n{problem.num_points}\n")
        write_tracks(
            file,
            ("%r %r %r %d %d %d %d", " %d %d %r %r", "\n"),
            np.column_stack([problem.points, colors_of(problem)]),
            np.column_stack([image, keys_of(problem), xy]),
            problem.observation_point,
        )
        file.write("\n0\n")
    fitted = (
        ()
        if not error
        else (f"Distortion is fitted by that of NVM; the largest error is {error:.2g} px.",)
    )
    return (
        *common_losses(problem, keeps=("names", "colors")),
        *moved_centers(problem),
        *fitted,
    )


def _distortion(problem: Problem, params: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return r of each image, and the largest error of the fits in pixels."""
    distortion, worst = np.zeros(len(params)), 0.0
    known = _known(problem)
    farthest = np.zeros(len(params))
    offset = problem.observation_xy - params[problem.observation_image, 1:3]
    np.maximum.at(farthest, problem.observation_image, np.hypot(offset[:, 0], offset[:, 1]))
    for image in np.flatnonzero(params[:, 3:].any(axis=1)).tolist():
        focal, _, _, k1, k2 = params[image]
        if image in known:
            distortion[image] = known[image]
            continue
        t = np.linspace(0, 2, 8 * _NUM_RADII + 1)[1:]
        s = t * (1 + k1 * t**2 + k2 * t**4)
        seen = np.cumprod(np.diff(s, prepend=0.0) > 0, dtype=bool)
        limit = farthest[image] / focal or 0.5
        seen &= s <= max(limit, s[0])
        t, s = t[seen], s[seen]
        r = float((s**3 @ (t - s)) / (s**3 @ s**3))
        distortion[image] = r
        slope = np.abs(1 + 3 * r * s**2)
        error = float((np.abs(s * (1 + r * s**2) - t) / slope).max() * focal)
        worst = max(worst, error)
    return distortion, worst


def _known(problem: Problem) -> dict[int, float]:
    """Return r by image, for images whose lens is as it was read."""
    source = imported_source(problem)
    if problem.format != "nvm" or source is None:
        return {}
    before, values = source.data["params"], source.data["distortion"]
    found = {}
    for image, (image_id, camera) in enumerate(
        zip(problem.image_ids.tolist(), problem.image_camera.tolist(), strict=True)
    ):
        own = problem.camera_params[camera]
        if 0 <= image_id < len(before) and np.array_equal(own, before[image_id][: len(own)]):
            found[image] = float(values[image_id])
    return found
