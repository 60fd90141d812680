"""Signed residuals of all observations: projection minus measurement, in pixels.

``bundle.reprojection_errors`` has only their lengths. Lens errors show in the directions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.model.problem import Problem
from bundle.model.reprojection import resolve_cheirality


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of the observations of a problem.

    Attributes:
        xy: (num_observations, 2) projection minus measurement [pixels], x right, y down; across a
            seam the shorter way; NaN if the point has no projection.
        counted: (num_observations,) True for observations that count: the point has a projection
            and, unless cheirality is "algebraic", is in front of the camera.
    """

    xy: NDArray[np.float64]
    counted: NDArray[np.bool_]

    @property
    def lengths(self) -> NDArray[np.float64]:
        """(num_observations,) lengths [pixels]; NaN without a projection."""
        return np.hypot(self.xy[:, 0], self.xy[:, 1])


def residuals(problem: Problem, cheirality: str = "auto") -> Residuals:
    """Return the residuals at the current values of a problem.

    Args:
        problem: the problem; not modified.
        cheirality: "algebraic", "zero" or "auto", as in :class:`SolveOptions`.
    """
    cheirality = resolve_cheirality(problem, cheirality)
    xy, behind = _core.reprojection_residuals(problem, 0, cheirality)
    counted = np.isfinite(xy[:, 0]) & np.isfinite(xy[:, 1])
    if cheirality != "algebraic":
        counted &= ~behind
    return Residuals(xy, counted)
