"""Rotations of many images at once, as matrices and as COLMAP's quaternions.

Every product is written element by element. BLAS would give different last bits on different
machines, and therefore a different scene for the same seed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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


def cross_matrices(vectors: Array) -> Array:
    """Return (..., 3, 3) matrices [v]x of (..., 3) vectors, [v]x a = v x a."""
    x, y, z = np.moveaxis(np.asarray(vectors), -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
