"""Residuals of observations at steps along a column of their Jacobian, by `bundle.project`.

The columns are those of the core's check: a rotation vector w near w0 with the rotation
Exp(w) Exp(-w0) R, the translation, the camera's parameters, the twist if shutters roll, the point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.checking.jacobian_deviation import Array
from bundle.checking.step_curve import Line, walk
from bundle.model.cameras import camera_models, project
from bundle.model.problem import Problem
from bundle.model.rotations import (
    quaternion_from_matrix,
    quaternion_from_vector,
    rotation_matrices,
)


@dataclass(frozen=True, eq=False)
class ReprojectionLines:
    """Observations of a problem, each turned by a rotation vector."""

    problem: Problem
    observations: NDArray[np.int64]
    offsets: Array

    def line(self, k: int, column: int) -> Line:
        """Return the residuals of observation k along a column."""
        problem, observation = self.problem, int(self.observations[k])
        image = int(problem.observation_image[observation])
        camera = int(problem.image_camera[image])
        model = problem.camera_models[camera]
        num_params = len(camera_models()[model])
        pose = problem.cam_from_world[image]
        back = rotation_matrices(quaternion_from_vector(-self.offsets[k][None]))[0]
        rotation = back @ rotation_matrices(pose[None, :4])[0]
        start = np.concatenate([
            self.offsets[k],
            pose[4:],
            problem.camera_params[camera, :num_params],
            problem.points[problem.observation_point[observation]],
        ])  # fmt: skip
        measured = problem.observation_xy[observation]
        shutter = problem.rolling_shutter
        if shutter is not None:
            start = np.concatenate([start[:-3], shutter.twist[image], start[-3:]])
            alone = problem.select(images=[image], observations=[observation]).problem

        def rolling(moved: Array) -> Array | None:
            """Return the residual by the core: the row depends on the point."""
            turn = rotation_matrices(quaternion_from_vector(moved[None, :3]))[0] @ rotation
            params, points = alone.camera_params.copy(), alone.points.copy()
            params[alone.image_camera[0], :num_params] = moved[6 : 6 + num_params]
            points[alone.observation_point[0]] = moved[-3:]
            assert alone.rolling_shutter is not None
            there = alone.replace(
                cam_from_world=np.hstack([quaternion_from_matrix(turn[None])[0], moved[3:6]])[None],
                camera_params=params,
                points=points,
                rolling_shutter=alone.rolling_shutter.replace(twist=moved[None, -9:-3]),
            )
            found = _core.reprojection_residuals(there, 1, "algebraic")[0][0]
            return found if np.isfinite(found).all() else None

        def values(step: float) -> Array | None:
            moved = start.copy()
            moved[column] += step
            if shutter is not None:
                return rolling(moved)
            turn = rotation_matrices(quaternion_from_vector(moved[None, :3]))[0]
            seen = turn @ rotation @ moved[-3:] + moved[3:6]
            pixels, _ = project(model, moved[6:-3], seen[None])
            found: Array = pixels[0] - measured
            return found if np.isfinite(found).all() else None

        center = values(0.0)
        return walk(values, np.full(2, np.nan) if center is None else center, start[column])
