"""Rotations and rigid motions of many images at once, as COLMAP's quaternions and translations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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


# Rotations of many images at once, as matrices and as COLMAP's quaternions.
#
# Every product is written element by element. BLAS would give different last bits on different
# machines, and therefore a different scene for the same seed.


def dot(a: Array, b: Array) -> Array:
    """Return the dot products of the last axes (..., 3)."""
    product: Array = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return product


def rotate(matrix: Array, vectors: Array) -> Array:
    """Return matrix (..., 3, 3) times vectors (..., 3), with broadcasting."""
    return np.stack([dot(matrix[..., row, :], vectors) for row in range(3)], axis=-1)


def look_along(forward: Array, roll: Array) -> Array:
    """Return camera-from-world rotations (N, 3, 3) of cameras looking along (N, 3) directions.

    The world's z axis is up; ``roll`` (N,) turns the image about its axis, in radians. No direction
    may be vertical.
    """
    z = forward / np.sqrt(dot(forward, forward))[:, None]
    x = np.stack([z[:, 1], -z[:, 0], np.zeros(len(z))], axis=-1)
    x /= np.sqrt(dot(x, x))[:, None]
    y = np.cross(z, x)
    c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
    return np.stack([c * x + s * y, c * y - s * x, z], axis=1)


def quaternion_from_matrix(matrix: Array) -> Array:
    """Return unit quaternions (N, 4) as qx qy qz qw, qw >= 0, of rotation matrices (N, 3, 3)."""
    m = matrix
    # Entries are 4 q_i q_j. Dividing the row of the largest component by it is numerically safe.
    xx = 1 + m[:, 0, 0] - m[:, 1, 1] - m[:, 2, 2]
    yy = 1 - m[:, 0, 0] + m[:, 1, 1] - m[:, 2, 2]
    zz = 1 - m[:, 0, 0] - m[:, 1, 1] + m[:, 2, 2]
    ww = 1 + m[:, 0, 0] + m[:, 1, 1] + m[:, 2, 2]
    xy, xz, yz = m[:, 1, 0] + m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0], m[:, 2, 1] + m[:, 1, 2]
    xw, yw, zw = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    rows = np.array([[xx, xy, xz, xw], [xy, yy, yz, yw], [xz, yz, zz, zw], [xw, yw, zw, ww]])
    largest = np.argmax([xx, yy, zz, ww], axis=0)
    q = rows[largest, :, np.arange(len(m))]
    q /= np.sqrt(q[:, 0] ** 2 + q[:, 1] ** 2 + q[:, 2] ** 2 + q[:, 3] ** 2)[:, None]
    return np.where(q[:, 3:] < 0, -q, q)


def quaternion_from_vector(vector: Array) -> Array:
    """Return unit quaternions (N, 4) of rotation vectors (N, 3) in radians."""
    angle = np.sqrt(dot(vector, vector))
    half_sinc = 0.5 * np.sinc(angle / (2 * np.pi))
    return np.concatenate([vector * half_sinc[:, None], np.cos(angle / 2)[:, None]], axis=1)


def vector_from_quaternion(q: Array) -> Array:
    """Return rotation vectors (N, 3), in radians and at most pi long, of quaternions (N, 4)."""
    q = np.where(q[:, 3:] < 0, -q, q)
    sine = np.linalg.norm(q[:, :3], axis=1)
    known = sine > 1e-12
    angle = 2 * np.arctan2(sine, q[:, 3])
    ratio = np.where(known, angle / np.where(known, sine, 1), 2 / np.linalg.norm(q, axis=1))
    vectors: Array = ratio[:, None] * q[:, :3]
    return vectors


def inverse_jacobian_coefficient(angle: Array) -> Array:
    """Return c of the inverse Jacobian I + [v]x / 2 + c [v]x^2 of SO(3), |v| = angle (N,).

    c = (1 - x cot x) / angle^2 with x = angle / 2; 1/12 at 0.
    """
    known = angle > 1e-3
    safe = np.where(known, angle, 1)
    exact = (1 - safe / 2 / np.tan(safe / 2)) / safe**2
    return np.where(known, exact, 1 / 12 + angle**2 / 720)


def quaternion_multiply(a: Array, b: Array) -> Array:
    """Return the products a b (N, 4): rotation b first, then a."""
    w = a[:, 3:] * b[:, 3:] - dot(a[:, :3], b[:, :3])[:, None]
    v = a[:, 3:] * b[:, :3] + b[:, 3:] * a[:, :3] + np.cross(a[:, :3], b[:, :3])
    return np.concatenate([v, w], axis=1)


def quaternion_inverse(q: Array) -> Array:
    """Return the inverses of unit quaternions (N, 4)."""
    inverse: Array = q * np.array([-1.0, -1.0, -1.0, 1.0])
    return inverse


def quaternion_rotate(q: Array, vectors: Array) -> Array:
    """Return vectors (N, 3) rotated by unit quaternions (N, 4)."""
    twice = 2.0 * np.cross(q[:, :3], vectors)
    return vectors + q[:, 3:] * twice + np.cross(q[:, :3], twice)


def rotation_matrices(quaternions: Array) -> Array:
    """Return (n, 3, 3) rotations of (n, 4) quaternions qx qy qz qw of any length."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def cross_rows(a: Array, b: Array) -> Array:
    """Return (n, 3) products a x b of (n, 3) or (3,) vectors, bit by bit those of np.cross.

    For some dozen rows, it takes a seventh of the time of np.cross.
    """
    (x, y, z), (u, v, w) = a.T, b.T
    return np.ascontiguousarray(np.array([y * w - z * v, z * u - x * w, x * v - y * u]).T)


def cross_matrices(vectors: Array) -> Array:
    """Return (..., 3, 3) matrices [v]x of (..., 3) vectors, [v]x a = v x a."""
    x, y, z = np.moveaxis(np.asarray(vectors), -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def center_jacobians(poses: Array) -> Array:
    """Return the derivatives (N, 3, 6) of the centres -R^T t of poses (N, 7) w.r.t. (w, t).

    For the pose (Exp(w) R, t + dt), the centre moves by -R^T (dt - w x t) = -R^T (dt + [t]_x w).
    """
    back = np.swapaxes(rotation_matrices(poses[:, :4]), 1, 2)
    return -np.concatenate([back @ cross_matrices(poses[:, 4:]), back], axis=2)
