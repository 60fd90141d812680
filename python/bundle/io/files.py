"""Inputs as users hand them over: paths of anything, problems, reconstructions in memory."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import is_path
from bundle.errors import InputError, brief
from bundle.io import open as io
from bundle.io.g2o_files import load_g2o, save_g2o
from bundle.io.recognition import is_pose_graph_file
from bundle.model import reprojection
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem

if TYPE_CHECKING:
    import pycolmap

__all__ = ["Source", "as_problem", "load", "reprojection_errors", "save"]

Source: TypeAlias = "Problem | str | os.PathLike[str] | pycolmap.Reconstruction"
"""A problem, the path of one, or a reconstruction in memory."""


def load(path: str | os.PathLike[str]) -> Any:
    """Read a reconstruction or a pose graph; the content decides which of them.

    Args:
        path: the folder of a COLMAP model (binary or text), a BAL file or a g2o file (both plain,
            gzip or bzip2).

    Returns:
        A :class:`bundle.Problem`, or a :class:`bundle.PoseGraph` for a g2o file.

    Raises:
        InputError: the content is not what its format says; one line with path, place, what was
            expected and what was found.
        OSError: the path does not exist or cannot be read.
    """
    return load_g2o(path) if is_pose_graph_file(path) else io.load(path)


def save(
    problem: Problem | PoseGraph,
    path: str | os.PathLike[str],
    format: str | None = None,
) -> tuple[str, ...]:
    """Write a reconstruction or a pose graph; return what the format does not keep.

    What stood at ``path`` is replaced only when the new content is whole on the disk. Of a folder,
    which must be empty or a COLMAP model, only the model files are replaced.

    Args:
        problem: what to write; a pose graph becomes a g2o file.
        path: a file (BAL or g2o; ".gz" and ".bz2" at the end compress) or a folder (COLMAP).
        format: "bal", "colmap" (binary) or "colmap-text" for a reconstruction; None: by the path,
            then by where the problem comes from.

    Raises:
        InputError: the format cannot hold the problem, or the path cannot be replaced.
        OSError: the system refuses: no permission, disk full.
    """
    if not isinstance(problem, PoseGraph):
        return io.save(problem, path, format)
    if format is not None:
        raise InputError(f"format: expected none for a pose graph, found {format}")
    return save_g2o(problem, path)


def as_problem(source: Source, name: str = "problem") -> Problem:
    """Return the problem that is meant: itself, what a path holds, or a reconstruction's.

    Args:
        source: any of these.
        name: of the argument, for errors.

    Raises:
        InputError: it is none of these, or what it stands for is no problem.
        OSError: the path does not exist or cannot be read.
    """
    if isinstance(source, Problem):
        return source
    if is_path(source):
        return io.load(source)
    # Whoever holds a reconstruction has imported pycolmap, which takes a while.
    pycolmap = sys.modules.get("pycolmap")
    if pycolmap is not None and isinstance(source, pycolmap.Reconstruction):
        return Problem.from_pycolmap(source)
    raise InputError(
        f"{name}: expected a Problem, a path or a pycolmap.Reconstruction, "
        f"found {brief(source)}{_hint(source)}"
    )


def _hint(source: Any) -> str:
    problem = getattr(source, "problem", None)
    return "; pass its .problem" if isinstance(problem, Problem) else ""


def reprojection_errors(
    problem: Source, *, cheirality: str = "auto", num_threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the reprojection error of each observation at the problem's own values.

    Args:
        problem: left untouched; also the path of one, or a pycolmap.Reconstruction.
        cheirality: with "zero" no lens sees farther than COLMAP lets it.
        num_threads: 0: all cores.

    Returns:
        Errors ||r|| in pixels, (num_observations,): projection minus measurement. Also defined for
        points behind their camera, by the formula; NaN where there is no projection. And a mask,
        (num_observations,), of points that the camera does not see: behind it, or where the formula
        of a wide lens, which goes on past 90 degrees, has ended.

    Raises:
        InputError: an observed image has a camera model that is not supported.
        OSError: the path cannot be read.

    Example:
        >>> errors, behind = bundle.reprojection_errors(result.problem)
        >>> outliers = (errors > 4.0) | behind
    """
    return reprojection.reprojection_errors(
        as_problem(problem), cheirality=cheirality, num_threads=num_threads
    )
