"""Inputs in any form: paths of any format, problems, reconstructions in memory."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import is_path
from bundle.errors import InputError, brief
from bundle.io import open as io
from bundle.io.formats.read_options import ReadOptions
from bundle.io.recognition import is_pose_graph_file
from bundle.model import residuals
from bundle.model.problem import Problem

if TYPE_CHECKING:
    import pycolmap

    from bundle.model.pose_graph_arrays import PoseGraph

Source: TypeAlias = "Problem | str | os.PathLike[str] | pycolmap.Reconstruction"
"""A problem, the path of a problem, or a reconstruction in memory."""


def load(
    path: str | os.PathLike[str],
    *,
    format: str | None = None,
    image_size: tuple[int, int] | str | None = None,
    image_list: str | os.PathLike[str] | None = None,
    reconstruction: int | None = None,
    pixel_origin: str = "center",
) -> Any:
    """Read a reconstruction or a pose graph; the content decides its format.

    Args:
        path: folder of a COLMAP model (binary or text) or of an OpenSfM project; a BAL, Bundler,
            NVM, OpenMVG (sfm_data.json) or g2o file, plain, gzip or bzip2.
        format: "bundler", "opensfm", "nvm", "openmvg", "colmap" or "bal"; None: by the content.
        image_size: width and height of all images in pixels, for formats without them, or
            "unknown"; None: from the photographs.
        image_list: list.txt of a Bundler model; None: in its folder or the folder above.
        reconstruction: number of the reconstruction in a file with several, from 0.
        pixel_origin: origin of the pixels of an NVM file: the "center" of the image, or the upper
            left "corner", as COLMAP writes it.

    Returns:
        A :class:`bundle.Problem`, or a :class:`bundle.PoseGraph` for a g2o file.

    Raises:
        InputError: the content violates its format; one line with path, place, expected and actual
            value.
        OSError: the path does not exist or cannot be read.
    """
    if not is_pose_graph_file(path):
        options = ReadOptions.of(format, image_size, image_list, reconstruction, pixel_origin)
        return io.load(path, options=options)
    from bundle.io.g2o_files import load_g2o  # late, as in save: few models need it

    return load_g2o(path)


def save(
    problem: Problem | PoseGraph,
    path: str | os.PathLike[str],
    format: str | None = None,
) -> tuple[str, ...]:
    """Write a reconstruction or a pose graph; return sentences on information that is lost.

    The content of ``path`` is replaced only when the new content is complete on the disk. A folder
    must be empty or a COLMAP model; only its model files are replaced.

    Args:
        problem: the reconstruction, or the pose graph, which becomes a g2o file.
        path: a BAL or g2o file (a name that ends in ".gz" or ".bz2" is compressed), a COLMAP
            folder, or a file or folder of another format.
        format: "bal", "colmap" (binary), "colmap-text", "bundler", "opensfm", "nvm", "openmvg",
            "transforms" or "ply" for a reconstruction. None: decided by the path, then by the
            source of the problem.

    Raises:
        InputError: the format cannot hold the problem, or the path cannot be replaced.
        OSError: a system call fails, for example without permission or on a full disk.
    """
    if not isinstance(problem, Problem):
        from bundle.io.g2o_files import save_g2o
        from bundle.model.pose_graph_arrays import PoseGraph

        if isinstance(problem, PoseGraph):
            if format is not None:
                raise InputError(f"format: expected none for a pose graph, found {format}")
            return save_g2o(problem, path)
    return io.save(problem, path, format)


def as_problem(source: Source, name: str = "problem") -> Problem:
    """Return the problem of a source: the problem itself, a path's, or a reconstruction's."""
    if isinstance(source, Problem):
        return source
    if is_path(source):
        return io.load(source)
    # A caller with a reconstruction has imported pycolmap; importing it here would be slow.
    pycolmap = sys.modules.get("pycolmap")
    if pycolmap is not None and isinstance(source, pycolmap.Reconstruction):
        return Problem.from_pycolmap(source)
    raise InputError(
        f"{name}: expected a Problem, a path or a pycolmap.Reconstruction, "
        f"found {brief(source)}{_hint(source)}"
    )


def _hint(source: Any) -> str:
    if hasattr(source, "problem"):
        return "; pass its .problem"
    return "; call its .solve()" if hasattr(source, "solve") else ""


def reprojection_errors(
    problem: Source, *, cheirality: str = "auto", num_threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the reprojection error of each observation at the problem's own values.

    Args:
        problem: a problem, the path of a problem, or a pycolmap.Reconstruction; not changed.
        cheirality: with "zero", no lens sees beyond COLMAP's limit for its model.
        num_threads: number of threads; 0: all cores.

    Returns:
        Errors ||r|| in pixels, (num_observations,): projection minus measurement. For points behind
        their camera, the projection formula is evaluated as for other points. NaN if the projection
        does not exist. Second, a mask, (num_observations,), of points that the camera does not see:
        points behind it, or, for a wide lens beyond 90 degrees, points outside its valid range.

    Raises:
        InputError: an observed image has a camera model that is not supported.
        OSError: the path cannot be read.

    Example:
        >>> errors, behind = bundle.reprojection_errors(result.problem)
        >>> outliers = (errors > 4.0) | behind
    """
    return residuals.reprojection_errors(
        as_problem(problem), cheirality=cheirality, num_threads=num_threads
    )
