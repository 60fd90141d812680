"""Problems, their paths and pycolmap reconstructions, as users hand them in."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bundle.base.paths import is_path
from bundle.errors import InputError, brief
from bundle.model import reprojection
from bundle.model.problem import Problem

if TYPE_CHECKING:
    import pycolmap

__all__ = ["Source", "as_problem", "reprojection_errors"]

Source: TypeAlias = "Problem | str | os.PathLike[str] | pycolmap.Reconstruction"
"""A problem, the path of one, or a reconstruction in memory."""


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
        from bundle.io.open import load

        return load(source)
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
