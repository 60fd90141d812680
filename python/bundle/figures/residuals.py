"""Signed residuals of all observations: projection minus measurement, in pixels.

``bundle.reprojection_errors`` has their lengths. A picture of what a lens does needs directions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.cameras import camera_models, project
from bundle.problem import Problem
from bundle.reprojection import resolve_cheirality
from bundle.rotations import rotate, rotation_matrices

__all__ = ["Residuals", "residuals"]

# Observations projected at once: some 300 MB.
AT_ONCE = 1_000_000


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of the observations of a problem.

    Attributes:
        xy: (num_observations, 2) projection minus measurement [pixels], x right, y down; nan where
            the point has no projection.
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
    xy = np.full((problem.num_observations, 2), np.nan)
    seen = np.zeros(problem.num_observations, bool)
    rotations = rotation_matrices(problem.cam_from_world[:, :4])
    camera = problem.image_camera[problem.observation_image]
    order = np.argsort(camera, kind="stable")
    bounds = np.searchsorted(camera[order], np.arange(problem.num_cameras + 1))
    for index in np.flatnonzero(np.diff(bounds)):
        model = problem.camera_models[index]
        params = problem.camera_params[index, : len(camera_models()[model])]
        for first in range(bounds[index], bounds[index + 1], AT_ONCE):
            rows = order[first : min(first + AT_ONCE, bounds[index + 1])]
            image = problem.observation_image[rows]
            points = rotate(rotations[image], problem.points[problem.observation_point[rows]])
            points += problem.cam_from_world[image, 4:]
            pixels, seen[rows] = project(model, params, points)
            xy[rows] = pixels - problem.observation_xy[rows]
    counted = np.isfinite(xy).all(axis=1)
    if resolve_cheirality(problem, cheirality) == "zero":
        counted &= seen
    return Residuals(xy, counted)
