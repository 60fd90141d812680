"""Adjoints of poses, many at once: X Exp(d) X^-1 = Exp(Ad_X d), as ``rigid_motion.h`` has them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.model.rotations import cross_matrices, rotation_matrices

__all__ = ["adjoint_between", "adjoints"]

Floats = NDArray[np.float64]


def adjoints(poses: Floats) -> Floats:
    """Return Ad of poses (n, 3) or (n, 7): (n, 3, 3) or (n, 6, 6) by tangent coordinates."""
    rotation, translation = _parts(poses)
    return _assemble(rotation, translation)


def adjoint_between(poses: Floats, reference: Floats) -> Floats:
    """Return Ad(X^-1 X_ref) of poses (n, ...) and one reference pose: (n, d, d).

    Translations are subtracted before they are turned: nothing is lost far from the origin.
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
