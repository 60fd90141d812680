"""Writer of Bundler's bundle.out and of list.txt beside it; ``bundler`` derives the conventions."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bundle.errors import InputError, shown
from bundle.io import bal
from bundle.io.atomic import atomic_write as atomic
from bundle.io.formats.bundler import FLIP, LIST
from bundle.io.formats.written_tracks import (
    check_names,
    colors_of,
    common_losses,
    keys_of,
    write_tracks,
)
from bundle.model.problem import Problem
from bundle.model.pycolmap.imported_source import imported_source
from bundle.model.rotations import rotation_matrices


def check(problem: Problem, path: Path) -> None:
    """Raise the error that :func:`write` would raise, or that list.txt would replace another's.

    Raises:
        InputError: a camera, a name or the folder cannot be written.
    """
    bal.radial_params(problem, "a Bundler file")
    check_names(problem, "list.txt")
    listed = path.parent / LIST
    if any(problem.image_names) and listed.exists() and not path.exists():
        raise InputError(
            f"{shown(path)}: expected a folder without {LIST}, which has the names of the images, "
            f"found {shown(listed)}"
        )


def write(problem: Problem, path: Path) -> tuple[str, ...]:
    """Write a Bundler file; return sentences on information that is lost."""
    params = bal.radial_params(problem, "a Bundler file")
    place, names = _places(problem)
    rows = np.zeros((len(names), 15))
    pose = problem.cam_from_world
    unit = pose[:, :4] / np.linalg.norm(pose[:, :4], axis=1)[:, None]
    rotations = FLIP[:, None] * rotation_matrices(unit)
    rows[place] = np.column_stack(
        [params[:, [0, 3, 4]], rotations.reshape(-1, 9), FLIP * pose[:, 4:]]
    )
    image = problem.observation_image
    xy = (problem.observation_xy - params[image, 1:3]) * np.array([1.0, -1.0])
    with path.open("w", encoding="utf-8") as file:
        file.write(f"# Bundle file v0.3\n{len(names)} {problem.num_points}\n")
        for row in rows.tolist():
            file.write("%r %r %r\n" * 5 % tuple(row))
        write_tracks(
            file,
            ("%r %r %r\n%d %d %d\n%d", " %d %d %r %r", "\n"),
            np.column_stack([problem.points, colors_of(problem)]),
            np.column_stack([place[image], keys_of(problem), xy]),
            problem.observation_point,
        )
    return (
        *common_losses(problem, keeps=("names", "colors")),
        *moved_centers(problem),
    )


def write_beside(problem: Problem, path: Path) -> None:
    """Write list.txt into the folder of a Bundler file, if images have names."""
    _, names = _places(problem)
    if any(names):
        lines = "".join(f"{name or 'unnamed'}\n" for name in names)
        with atomic.replace_file(path.parent / LIST) as temporary:
            temporary.write_text(lines, "utf-8", errors="surrogateescape")


def moved_centers(problem: Problem) -> tuple[str, ...]:
    """Return a sentence if principal points are not the centres of the images."""
    params = bal.radial_params(problem)
    sizes = problem.camera_sizes[problem.image_camera]
    off = np.abs(params[:, 1:3] - sizes / 2).max(initial=0.0)
    if not off or not sizes.any():
        return ()
    return (
        f"Principal points, up to {off:.4g} px off the centre of the image, become the centre: "
        "positions are relative to them.",
    )


def _places(problem: Problem) -> tuple[np.ndarray, list[str]]:
    """Return the position of each image in the file, and the names of all images of the file.

    Images of a Bundler file keep their positions, with those that are not registered between them.
    """
    source, ids = imported_source(problem), problem.image_ids
    if problem.format == "bundler" and source is not None:
        names = list(source.data["names"])
        if len(ids) and ids.min() >= 0 and ids.max() < len(names):
            return ids, names
    return np.arange(problem.num_images), list(problem.image_names)
