"""A refinement as a function of arrays, with its derivatives, for torch and jax.

A weight w = 1 / s^2 is that of an observation's squared residual, 1/2 rho(w |r|^2), so that dL/dw =
-s^3 / 2 dL/ds. A pose is the quaternion q = (v, c), v its vector, and the translation. As R moves
to Exp(w) R, dq = (w / 2, 0) q, and a derivative (g, h) with respect to q becomes

    by w:    1/2 (c g + v x g - h v).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.adjoint import Adjoint, adjoint
from bundle.base.arrays import Array, as_declared, check_type
from bundle.model.problem import Problem
from bundle.solving.solve import solve

_Floats = NDArray[np.float64]

DATA = {"pixels": "finite", "weights": "above 0", "cameras": "finite"}
"""Arguments of a layer, and what their numbers must be."""

OF_SOLVE = {"function_tolerance": 1e-12, "parameter_tolerance": 1e-12}
"""Options of the solve before the Newton steps, unless others are given."""


class Refined(NamedTuple):
    """Values at the minimum."""

    points: Any  # (num_points, 3)
    poses: Any  # (num_images, 7) cam_from_world: qx qy qz qw tx ty tz
    cameras: Any  # (num_cameras, k) camera_params


class Layer:
    """A problem whose pixels, weights and constant camera parameters vary.

    ``data``: those of the problem.
    """

    def __init__(self, problem: Any, settings: Mapping[str, Any]) -> None:
        check_type("problem", problem, Problem)
        sigma = problem.observation_sigma
        weights = np.ones(problem.num_observations) if sigma is None else sigma**-2.0
        self.data = (problem.observation_xy, weights, problem.camera_params)
        self._problem, self._settings = problem, dict(settings)
        self._last: tuple[list[_Floats], Adjoint] | None = None

    def minimum(self, *data: Any) -> Adjoint:
        """Solve with these data, and return the polished minimum.

        The last one is kept, for the backward pass of jax, which has the data only.
        """
        if self._last is None or not all(map(np.array_equal, data, self._last[0])):
            xy, weights, params = arrays = [
                as_declared(name, one, Array(default.shape, values)).copy()
                for (name, values), one, default in zip(DATA.items(), data, self.data, strict=True)
            ]
            start = self._problem.replace(
                observation_xy=xy, observation_sigma=weights**-0.5, camera_params=params
            )
            given = {"align": False} if self._settings.get("priors") else {}
            solved = solve(start, **{**OF_SOLVE, **self._settings, **given}).problem
            self._last = arrays, adjoint(solved, **self._settings)
        return self._last[1]


def values_of(minimum: Adjoint) -> Refined:
    """Return copies of the refined values."""
    problem = minimum.problem
    arrays = (problem.points, problem.cam_from_world, problem.camera_params)
    return Refined(*(array.copy() for array in arrays))


def pulled_back(minimum: Adjoint, points: Any, poses: Any, cameras: Any) -> tuple[_Floats, ...]:
    """Return derivatives w.r.t. the data, from those w.r.t. :class:`Refined`; NaN if none exist."""
    q, by_pose = minimum.problem.cam_from_world[:, :4], np.asarray(poses, float)
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    g, h, v, c = by_pose[:, :3], by_pose[:, 3:4], q[:, :3], q[:, 3:]
    tangent = np.hstack([0.5 * (c * g + np.cross(v, g) - h * v), by_pose[:, 4:]])
    found = minimum.vjp(points=points, poses=tangent, cameras=cameras)
    sigma = np.asarray(minimum.problem.observation_sigma)
    return found.pixels, -0.5 * sigma**3 * found.sigmas, found.held
