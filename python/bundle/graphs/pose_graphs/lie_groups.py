"""Operations of SE(2) and SE(3) on arrays of poses, (n, 3) or (n, 7), as in ``rigid_motion.h``.

The adjoint Ad_X moves a perturbation from the right to the left: X Exp(d) X^-1 = Exp(Ad_X d).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.model.rigid_motions import (
    cross_matrices,
    inverse_jacobian_coefficient,
    inverse_poses,
    log_of_poses,
    multiply_poses,
    rotation_matrices,
    unit_poses,
)

Floats = NDArray[np.float64]


def adjoints(poses: Floats) -> Floats:
    """Return Ad of poses (n, 3) or (n, 7): (n, 3, 3) or (n, 6, 6) in tangent coordinates."""
    rotation, translation = _parts(poses)
    return _assemble(rotation, translation)


def adjoint_between(poses: Floats, reference: Floats) -> Floats:
    """Return Ad(X^-1 X_ref) of poses (n, ...) and one reference pose: (n, d, d).

    Translations are subtracted before they are rotated, so that no digits are lost far from the
    origin.
    """
    rotation, translation = _parts(poses)
    base, origin = _parts(reference[None])
    back = rotation.transpose(0, 2, 1)
    return _assemble(back @ base, (back @ (origin - translation)[:, :, None])[:, :, 0])


def _parts(poses: Floats) -> tuple[Floats, Floats]:
    if poses.shape[1] == 3:
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        rotation = np.array([[c, -s], [s, c]]).transpose(2, 0, 1)
        return rotation, poses[:, :2]
    return rotation_matrices(poses[:, :4]), poses[:, 4:]


def _assemble(rotation: Floats, translation: Floats) -> Floats:
    count = len(rotation)
    if rotation.shape[1] == 2:
        found = np.zeros((count, 3, 3))
        found[:, :2, :2] = rotation
        found[:, 0, 2], found[:, 1, 2] = translation[:, 1], -translation[:, 0]
        found[:, 2, 2] = 1
        return found
    found = np.zeros((count, 6, 6))
    found[:, :3, :3] = found[:, 3:, 3:] = rotation
    found[:, 3:, :3] = cross_matrices(translation) @ rotation
    return found


def compose(one: Floats, other: Floats) -> Floats:
    """Return the products of poses, ``one @ other``."""
    if one.shape[1] == 3:
        c, s = np.cos(one[:, 2]), np.sin(one[:, 2])
        x = one[:, 0] + c * other[:, 0] - s * other[:, 1]
        y = one[:, 1] + s * other[:, 0] + c * other[:, 1]
        return np.stack([x, y, one[:, 2] + other[:, 2]], axis=1)
    return multiply_poses(unit_poses(one), other)


def inverse(poses: Floats) -> Floats:
    """Return the inverses of poses."""
    if poses.shape[1] == 3:
        c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        x, y = poses[:, 0], poses[:, 1]
        return np.stack([-c * x - s * y, s * x - c * y, -poses[:, 2]], axis=1)
    return inverse_poses(unit_poses(poses))


def logarithm(poses: Floats) -> Floats:
    """Return Log of poses, (n, d)."""
    if poses.shape[1] == 3:
        angle = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
        x, y = poses[:, 0], poses[:, 1]
        along = 1 - inverse_jacobian_coefficient(np.abs(angle)) * angle**2
        half = angle / 2
        return np.stack([along * x + half * y, along * y - half * x, angle], axis=1)
    return log_of_poses(poses)
