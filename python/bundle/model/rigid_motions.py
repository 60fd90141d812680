"""Rigid motions of many poses at once, (n, 7) as qx qy qz qw tx ty tz."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.model.rotations import (
    inverse_jacobian_coefficient,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_rotate,
    vector_from_quaternion,
)

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
    """Return the products a b (n, 7), motion b first, then a; quaternions are unit."""
    turned = quaternion_multiply(a[:, :4], b[:, :4])
    return np.hstack([turned, quaternion_rotate(a[:, :4], b[:, 4:]) + a[:, 4:]])


def log_of_poses(poses: Array) -> Array:
    """Return Log of poses (n, 6), rotation vector r first: V^-1 t, V^-1 = I - [r]/2 + c [r]^2."""
    turn, place = vector_from_quaternion(poses[:, :4]), poses[:, 4:]
    once = np.cross(turn, place)
    bend = inverse_jacobian_coefficient(np.linalg.norm(turn, axis=1))[:, None]
    return np.concatenate([turn, place - once / 2 + bend * np.cross(turn, once)], axis=1)


def multiply_as_colmap(a: Array, b: Array) -> Array:
    """Return the products a b (n, 7), motion b first, then a, bit for bit as in COLMAP.

    The operations and their order are those of Eigen's quaternions on x86-64. The product of the
    quaternions is normalised; the quaternion that rotates the vector is not.
    """
    x, y, z, w = a.T[:4]
    bx, by, bz, bw = b.T[:4]
    turned = np.stack(
        [
            (w * bx + y * bz) - (z * by - x * bw),
            (w * by + y * bw) + (z * bx - x * bz),
            (w * bz - y * bx) + (z * bw + x * by),
            (w * bw - y * by) - (z * bz + x * bx),
        ]
    )
    squares = turned * turned
    turned /= np.sqrt((squares[0] + squares[2]) + (squares[1] + squares[3]))
    u, v = a.T[:3], b.T[4:]
    twice = _cross(u, v)
    twice += twice
    return np.vstack([turned, v + w * twice + _cross(u, twice) + a.T[4:]]).T


def _cross(u: Array, v: Array) -> Array:
    """Return the cross products of the columns of (3, n) arrays."""
    return np.stack(
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    )
