"""Problems that cannot be refined, in the same words for every format and command.

They have no observations, or each of their points is seen by one image only. Exports of learned
models, such as those of VGGT without bundle adjustment, are of the latter kind: a point is a pixel
with its depth, its residual is zero wherever the camera is, and nothing connects the images.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bundle.base.words import Counts, contents, plural
from bundle.errors import InputError
from bundle.model.problem_arrays import ProblemArrays

if TYPE_CHECKING:
    from bundle.interface.options import SolveOptions

_ADVICE = "; triangulate points first, for example with `colmap point_triangulator`"


def unobserved(problem: Counts) -> str:
    """Return a sentence about a problem without observations; empty with observations."""
    found = _content_without_observations(problem)
    return f"There are no observations to refine, only {found}." if found else ""


def require_observations(problem: Counts, name: str) -> None:
    """Refuse a problem that cannot be refined."""
    found = _content_without_observations(problem)
    if found:
        raise InputError(f"{name}: expected observations to refine, found {found}")


def are_images_unrelated(problem: ProblemArrays, options: SolveOptions) -> bool:
    """Return True if all points are refined and no point is constant or observed twice.

    Priors, factors and rules, which also connect images, are not considered.
    """
    if "points" not in options.refine or options.fixed_point_ids:
        return False
    return bool(np.bincount(problem.observation_point).max(initial=0) == 1)


def require_tracks(problem: ProblemArrays, name: str, options: SolveOptions) -> None:
    """Refuse a problem whose refined points connect no images."""
    if are_images_unrelated(problem, options):
        raise InputError(
            f"{name}: expected points that several images see, found "
            f"{plural(problem.num_observations, 'point')} with one observation each; export the "
            "tracks, too, for example VGGT's with --use_ba"
        )


def _content_without_observations(problem: Counts) -> str:
    if problem.num_observations:
        return ""
    return contents(problem) + (_ADVICE if problem.num_images and not problem.num_points else "")
