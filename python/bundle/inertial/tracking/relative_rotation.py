"""Rotation between two images from corresponding rays, by Gauss-Newton from an essential matrix.

Rays x and y of one point satisfy y . (t x R x) = 0 (coplanarity). With v = R x, left perturbation
R <- Exp(w) R and t <- t + d, the derivatives are

    d e / d w  =  y (t . v) - t (y . v),        d e / d t  =  v x y.

e is divided by the length of its gradient with respect to both image points (Sampson, 1982), which
makes it a distance on the image plane. Weights are Cauchy's. t moves on the unit sphere: d is
perpendicular to it. Without translation, t is arbitrary and R still determined; a small damping
keeps the step finite.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.model.rigid_motions import cross_matrices, quaternion_from_vector, rotation_matrices

Array = np.ndarray[Any, Any]

STEPS = 6
DAMPING = 1e-6  # of the trace of the normal matrix


def refined_rotation(
    one: Array, other: Array, rotation: Array, direction: Array, sigma: float
) -> Array:
    """Return the rotation (3, 3) other_from_one that explains all correspondences best.

    Args:
        one: (n, 2) normalised coordinates in the first image.
        other: (n, 2) in the second.
        rotation: (3, 3) initial value.
        direction: (3,) direction of the translation.
        sigma: standard deviation of normalised coordinates.
    """
    ones = np.ones((len(one), 1))
    x, y = np.hstack([one, ones]), np.hstack([other, ones])
    t = np.asarray(direction, np.float64).ravel()
    t = t / np.linalg.norm(t)
    for _ in range(STEPS):
        v = x @ rotation.T
        essential = cross_matrices(t[None])[0] @ rotation
        lines = np.hstack([(x @ essential.T)[:, :2], (y @ essential)[:, :2]])
        length = np.maximum(np.linalg.norm(lines, axis=1), 1e-12)
        error = np.einsum("ni,ni->n", y, np.cross(t, v)) / length
        tangent = np.linalg.svd(t[None])[2][1:]  # (2, 3)
        by_turn = y * (v @ t)[:, None] - t * np.einsum("ni,ni->n", y, v)[:, None]
        by_direction = np.cross(v, y) @ tangent.T
        jacobian = np.hstack([by_turn, by_direction]) / length[:, None]
        weight = 1 / (1 + (error / sigma) ** 2)
        normal = jacobian.T @ (weight[:, None] * jacobian)
        normal += DAMPING * np.trace(normal) * np.eye(5)
        step = -np.linalg.solve(normal, jacobian.T @ (weight * error))
        rotation = rotation_matrices(quaternion_from_vector(step[None, :3]))[0] @ rotation
        t = t + step[3:] @ tangent
        t = t / np.linalg.norm(t)
    return rotation
