"""Problems that cannot be refined, in the same words for every format and command.

They have no observations, or only points that one image sees each. Exports of learned models, such
as those of VGGT without bundle adjustment, are of the latter kind: a point is a pixel with its
depth, its residual is zero wherever the camera is, and nothing relates the images.
"""

from __future__ import annotations

import numpy as np

from bundle.base.words import Counts, contents, plural
from bundle.errors import InputError
from bundle.model.problem_arrays import ProblemArrays

__all__ = ["require_observations", "require_tracks", "unobserved"]

_ADVICE = "; triangulate points first, for example with `colmap point_triangulator`"


def unobserved(problem: Counts) -> str:
    """Return a sentence about a problem without observations; empty with observations."""
    found = _content_without_observations(problem)
    return f"There are no observations to refine, only {found}." if found else ""


def require_observations(problem: Counts, name: str) -> None:
    """Refuse a problem that cannot be refined.

    Args:
        problem: the problem.
        name: path or name, for the message.

    Raises:
        InputError: there are no observations.
    """
    found = _content_without_observations(problem)
    if found:
        raise InputError(f"{name}: expected observations to refine, found {found}")


def require_tracks(problem: ProblemArrays, name: str) -> None:
    """Refuse a problem whose points relate no images.

    Args:
        problem: a problem with observations, whose points are refined.
        name: path or name, for the message.

    Raises:
        InputError: no point is observed twice.
    """
    if np.bincount(problem.observation_point).max(initial=0) == 1:
        raise InputError(
            f"{name}: expected points that several images see, found "
            f"{plural(problem.num_observations, 'point')} with one observation each; export the "
            "tracks, too, for example VGGT's with --use_ba"
        )


def _content_without_observations(problem: Counts) -> str:
    if problem.num_observations:
        return ""
    return contents(problem) + (_ADVICE if problem.num_images and not problem.num_points else "")
