"""Signed residuals of all observations: projection minus measurement, in pixels.

``bundle.reprojection_errors`` has their lengths alone. Errors of a lens show in directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.model.problem import Problem
from bundle.model.reprojection import resolve_cheirality

__all__ = ["Residuals", "residuals"]


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of the observations of a problem.

    Attributes:
        xy: (num_observations, 2) projection minus measurement [pixels], x right, y down, the
            shorter way around a seam; nan where the point has no projection.
        counted: (num_observations,) whether the observation counts: it has a projection and, unless
            cheirality is "algebraic", the camera sees the point.
    """

    xy: NDArray[np.float64]
    counted: NDArray[np.bool_]

    @property
    def lengths(self) -> NDArray[np.float64]:
        """(num_observations,) lengths [pixels]; nan where there is no projection."""
        return np.hypot(self.xy[:, 0], self.xy[:, 1])


def residuals(problem: Problem, cheirality: str = "auto") -> Residuals:
    """Return the residuals at a problem's own values.

    Args:
        problem: left untouched.
        cheirality: "algebraic", "zero" or "auto", as in :class:`SolveOptions`.
    """
    cheirality = resolve_cheirality(problem, cheirality)
    xy, behind = _core.reprojection_residuals(problem, 0, cheirality)
    counted = np.isfinite(xy[:, 0]) & np.isfinite(xy[:, 1])
    if cheirality != "algebraic":
        counted &= ~behind
    return Residuals(xy, counted)
