"""A problem moved by a similarity.

With x' = s R x + t the camera frames keep their axes and grow with the scene: a point at
R_c x + t_c before its camera is at s (R_c x + t_c) after. So

    R_c' = R_c R^T,  t_c' = s t_c - R_c' t,

and no projection changes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.georeference.similarity import Similarity
from bundle.problem import Problem

__all__ = ["moved", "rotation_matrices"]

Array = NDArray[np.float64]


def moved(problem: Problem, similarity: Similarity) -> Problem:
    """Return the problem where the similarity puts it; observations and cameras stay."""
    quaternions = _times_inverse(problem.cam_from_world[:, :4], quaternion_of(similarity.rotation))
    turned = rotation_matrices(quaternions) if len(quaternions) else np.zeros((0, 3, 3))
    translations = similarity.scale * problem.cam_from_world[:, 4:]
    translations = translations - turned @ similarity.translation
    return problem.replace(
        cam_from_world=np.hstack([quaternions, translations]),
        points=similarity.apply(problem.points),
    )


def rotation_matrices(quaternions: Array) -> Array:
    """Return (n, 3, 3) rotations of (n, 4) quaternions qx qy qz qw of any length."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def quaternion_of(rotation: Array) -> Array:
    """Return qx qy qz qw of a rotation: the eigenvector of the largest eigenvalue (Bar-Itzhack)."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [0, r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [0, 0, r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [0, 0, 0, r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    quaternion: Array = np.linalg.eigh(k, UPLO="U")[1][:, -1]
    return quaternion


def _times_inverse(q: Array, p: Array) -> Array:
    """Return (n, 4) products of q (n, 4) and the conjugate of p (4,)."""
    v, w = q[:, :3], q[:, 3:]
    u, c = -p[:3], p[3]
    return np.hstack([w * u + c * v + np.cross(v, u), w * c - v @ u[:, None]])
