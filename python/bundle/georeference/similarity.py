"""Similarities x -> s R x + t: least squares in closed form, and problems moved by them.

With the centred points a_i of a model, their targets b_i, and sum b a^T = U D V^T (Umeyama,
"Least-squares estimation of transformation parameters between two point patterns", PAMI 13(4),
1991),

    R = U diag(1, 1, d) V^T,  d = det(U) det(V),  s = (D_1 + D_2 + d D_3) / sum |a|^2.

Coplanar points give D_3 = 0, and R is still unique, because d is chosen so that R is a rotation.
Only D_2 = 0, collinear points, leaves an angle free.

Under x' = s R x + t the camera frames keep their axes and scale with the scene: a point at R_c x +
t_c in its camera moves to s (R_c x + t_c). So

    R_c' = R_c R^T,  t_c' = s t_c - R_c' t,

and no projection changes. Frames of rigs move as cameras do. What is in the frame of a camera or a
rig scales with the scene: t_s' = s t_s for a sensor_from_rig, and likewise the translation of a
rolling shutter's twist. ``bundle.model.estimates`` has the rule of each array.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.georeference.local_frame import without_origin
from bundle.model.estimates import VARIABLES, Variable, estimates, with_estimates
from bundle.model.problem import Problem
from bundle.model.rig_arrays import placed
from bundle.model.rigid_motions import (
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    rotation_matrices,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Similarity:
    """Map x -> scale * rotation @ x + translation.

    Attributes:
        scale: metres per length unit of the model.
        rotation: (3, 3).
        translation: (3,) metres.
    """

    scale: float
    rotation: Array
    translation: Array

    def apply(self, points: Array) -> Array:
        """Return (n, 3) mapped points."""
        mapped: Array = self.scale * points @ self.rotation.T + self.translation
        return mapped

    def after(self, first: Similarity) -> Similarity:
        """Return the composition: ``first``, then this similarity."""
        return Similarity(
            self.scale * first.scale,
            self.rotation @ first.rotation,
            self.apply(first.translation[None])[0],
        )

    def asdict(self) -> dict[str, Any]:
        """Return scale, rotation (three rows) and translation by name."""
        return {
            "scale": self.scale,
            "rotation": self.rotation.tolist(),
            "translation": self.translation.tolist(),
        }


def umeyama(source: Array, target: Array) -> Similarity:
    """Return the least-squares similarity, with the same weight for every point.

    Args:
        source: (n, 3) points of the model.
        target: (n, 3) target positions of these points.
    """
    center, goal = source.mean(axis=0), target.mean(axis=0)
    scale, rotation = scale_and_rotation(source - center, target - goal)
    return Similarity(float(scale), rotation, goal - scale * rotation @ center)


def scale_and_rotation(a: Array, b: Array) -> tuple[Array, Array]:
    """Return scales (...) and rotations (..., 3, 3) of sets of centred points (..., n, 3)."""
    u, d, vt = np.linalg.svd(np.swapaxes(b, -1, -2) @ a)
    sign = np.ones_like(d)
    sign[..., 2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation: Array = (u * sign[..., None, :]) @ vt
    scale: Array = (d * sign).sum(axis=-1) / (a**2).sum(axis=(-2, -1))
    return scale, rotation


def moved(problem: Problem, similarity: Similarity) -> Problem:
    """Return the problem moved by the similarity; observations and cameras do not change."""
    known = estimates(problem)
    values = {
        one.name: _moved(known[one.name], one, similarity)
        for one in VARIABLES
        if one.name in known and one.similarity != "none"
    }
    if problem.num_frames:
        rigs = {name: getattr(problem, name) for name in ("image_frame", "image_sensor")}
        values["cam_from_world"] = placed(rigs | values)
    return without_origin(with_estimates(problem, values, checked=True))


def _moved(values: Array, variable: Variable, similarity: Similarity) -> Array:
    """Return an array of a problem after a similarity of the world, as the table says."""
    if variable.similarity == "pose":
        return _moved_poses(values, similarity)
    if variable.similarity == "point":
        return similarity.apply(values)
    moved = values.copy()
    moved[:, variable.lengths] *= similarity.scale
    return moved


def _moved_poses(poses: NDArray[np.float64], similarity: Similarity) -> NDArray[np.float64]:
    back = quaternion_inverse(quaternion_from_matrix(similarity.rotation[None]))
    quaternions = quaternion_multiply(poses[:, :4], back)
    turned = rotation_matrices(quaternions)
    translations = similarity.scale * poses[:, 4:] - turned @ similarity.translation
    return np.hstack([quaternions, translations])
