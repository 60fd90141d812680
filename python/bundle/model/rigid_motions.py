"""Rigid motions of many poses at once, (n, 7) as qx qy qz qw tx ty tz."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.model.rotations import quaternion_inverse, quaternion_multiply, quaternion_rotate

__all__ = ["inverse_poses", "multiply_poses", "unit_poses"]

Array = NDArray[np.float64]


def unit_poses(poses: Array) -> Array:
    """Return poses (n, 7) with quaternions of norm 1."""
    norm = np.sqrt((poses[:, :4] ** 2).sum(axis=1, keepdims=True))
    return np.hstack([poses[:, :4] / norm, poses[:, 4:]])


def inverse_poses(poses: Array) -> Array:
    """Return the inverses of poses (n, 7) with unit quaternions."""
    back = quaternion_inverse(poses[:, :4])
    return np.hstack([back, -quaternion_rotate(back, poses[:, 4:])])


def multiply_poses(a: Array, b: Array) -> Array:
    """Return the motions (n, 7) b, then a, of poses with unit quaternions."""
    turned = quaternion_multiply(a[:, :4], b[:, :4])
    return np.hstack([turned, quaternion_rotate(a[:, :4], b[:, 4:]) + a[:, 4:]])
