"""Residuals as users of Ceres, GTSAM, g2o and manif write them, with right Jacobians.

Every residual is a function of its values, with Jacobians by the right perturbation X Exp(d), the
rotation first. `Library` turns them into the coordinates of a library, by matrices that are
computed here from 4 x 4 products and not from the package.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from tests.checking.reprojection import left_jacobian, skew


class Residual(NamedTuple):
    """A function of values, its variables, and how it is scaled."""

    function: Callable[[list[Any]], tuple[Any, list[Any]]]
    values: list[Any]
    manifolds: list[str]


def homogeneous(pose):
    """4 x 4 of qx qy qz qw tx ty tz."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(pose[:4]).as_matrix(), pose[4:]
    return matrix


def twist(xi):
    """4 x 4 of rotation and translation."""
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = skew(xi[:3]), xi[3:]
    return matrix


def vee(matrix):
    return np.array([matrix[2, 1], matrix[0, 2], matrix[1, 0], *matrix[:3, 3]])


TWISTS = np.array([twist(e) for e in np.eye(6)])


def adjoint(matrix):
    """Ad, column by column."""
    return vee(np.moveaxis(matrix @ TWISTS @ np.linalg.inv(matrix), 0, -1))


def logarithm(matrix):
    """Rotation and translation of the twist of a 4 x 4."""
    w = Rotation.from_matrix(matrix[:3, :3]).as_rotvec()
    return np.append(w, np.linalg.solve(left_jacobian(w), matrix[:3, 3]))


def right_jacobian(xi):
    """J_r of SE(3): (1 - exp(-ad)) / ad, from the exponential of a block matrix."""
    ad = np.zeros((6, 6))
    ad[:3, :3] = ad[3:, 3:] = skew(xi[:3])
    ad[3:, :3] = skew(xi[3:])
    both = np.zeros((12, 12))
    both[:6, :6], both[:6, 6:] = -ad, np.eye(6)
    return expm(both)[:6, 6:]


def random_pose(rng, size=1.0):
    return np.append(Rotation.random(random_state=rng).as_quat(), rng.normal(0, size, 3))


def sighting(rng, scale=1.0, offset=0.0):
    """A point in the frame of a body, world_from_body."""

    def function(values):
        pose, point = values
        turn = Rotation.from_quat(pose[:4]).as_matrix()
        seen = turn.T @ (point - pose[4:])
        return seen, [np.hstack([skew(seen), -np.eye(3)]), turn.T]

    pose = random_pose(rng, 2 * scale)
    pose[4:] += offset
    point = offset + scale * rng.uniform(3, 6, 3)
    return Residual(function, [pose, point], ["se3", "euclidean"])


def reprojection(rng, scale=1.0, offset=0.0, depth=4.0):
    """A pixel of a point, camera_from_world, with focal length and one distortion."""

    def function(values):
        pose, point, (f, k) = values
        turn = Rotation.from_quat(pose[:4]).as_matrix()
        x, y, z = turn @ point + pose[4:]
        u = np.array([x, y]) / z
        square = u @ u
        by_seen = np.array([[1, 0, -u[0]], [0, 1, -u[1]]]) / z
        bend = (1 + k * square) * np.eye(2) + 2 * k * np.outer(u, u)
        by_seen = f * bend @ by_seen
        # X Exp(d): R Exp(w) p + t + R v
        by_pose = by_seen @ np.hstack([-turn @ skew(point), turn])
        by_lens = np.column_stack([(1 + k * square) * u, f * square * u])
        return f * (1 + k * square) * u, [by_pose, by_seen @ turn, by_lens]

    pose = random_pose(rng, scale)
    seen = scale * depth * np.array([*rng.uniform(-0.4, 0.4, 2), 1])
    point = offset + Rotation.from_quat(pose[:4]).inv().apply(seen - pose[4:])
    pose[4:] = seen - Rotation.from_quat(pose[:4]).apply(point)
    lens = np.array([rng.uniform(400, 1500), rng.uniform(0.05, 0.2)])
    return Residual(function, [pose, point, lens], ["se3", "euclidean", "euclidean"])


def between(rng, scale=1.0, offset=0.0, angle=0.4):
    """The logarithm of Z^-1 X_i^-1 X_j."""
    measured = homogeneous(random_pose(rng, scale))

    def function(values):
        first, second = map(homogeneous, values)
        relative = np.linalg.inv(first) @ second
        error = logarithm(np.linalg.inv(measured) @ relative)
        by_second = np.linalg.inv(right_jacobian(error))
        return error, [-by_second @ adjoint(np.linalg.inv(relative)), by_second]

    first = random_pose(rng, scale)
    first[4:] += offset
    axis = rng.standard_normal(3)
    off = np.append(angle * axis / np.linalg.norm(axis), 0.2 * scale * rng.normal(size=3))
    second = homogeneous(first) @ measured @ expm(twist(off))
    last = np.append(Rotation.from_matrix(second[:3, :3]).as_quat(), second[:3, 3])
    return Residual(function, [first, last], ["se3", "se3"])


def bearing(rng, scale=1.0, offset=0.0):
    """Range and bearing from a pose in the plane."""

    def function(values):
        (x, y, angle), landmark = values
        dx, dy = landmark - [x, y]
        square = dx * dx + dy * dy
        length = np.sqrt(square)
        c, s = np.cos(angle), np.sin(angle)
        by_landmark = np.array([[dx / length, dy / length], [-dy / square, dx / square]])
        by_pose = np.hstack([-by_landmark @ [[c, -s], [s, c]], [[0], [-1]]])
        off = np.arctan2(dy, dx) - angle
        return np.array([length, np.arctan2(np.sin(off), np.cos(off))]), [by_pose, by_landmark]

    place = offset + scale * rng.uniform(-2, 2, 2)
    landmark = place + scale * rng.uniform(2, 6, 2)
    pose = np.append(place, rng.uniform(-3, 3))
    return Residual(function, [pose, landmark], ["se2", "euclidean"])


def align(rng, scale=1.0, offset=0.0):
    """A turned vector."""

    def function(values):
        turn = Rotation.from_quat(values[0]).as_matrix()
        return turn @ values[1], [-turn @ skew(values[1]), turn]

    vector = offset + scale * rng.uniform(1, 3, 3)
    return Residual(function, [random_pose(rng)[:4], vector], ["so3", "euclidean"])


RESIDUALS = {f.__name__: f for f in (sighting, reprojection, between, bearing, align)}


def motion(library, manifold, value):
    """M, delta = M d, of a library: delta moves X to X Exp(delta), the rotation first."""
    if manifold == "euclidean" or manifold == "so2":
        return np.eye(len(value))
    if manifold == "se2":
        matrix = np.eye(3)
        if library == "g2o":  # VertexSE2 adds the translation
            c, s = np.cos(value[2]), np.sin(value[2])
            matrix[:2, :2] = [[c, s], [-s, c]]
        return matrix
    if manifold == "so3":
        left = Rotation.from_quat(value).as_matrix().T
        return {"g2o": 2 * np.eye(3), "g2o_expmap": left}.get(library, np.eye(3))
    matrix = np.eye(6)
    if library == "g2o":
        matrix[:3, :3] *= 2
    if library == "g2o_expmap":
        matrix = adjoint(np.linalg.inv(homogeneous(value)))
    return matrix[:, [3, 4, 5, 0, 1, 2]] if library in ("g2o", "manif") else matrix


def in_library(residual, library):
    """A residual with the Jacobians of a library."""

    def function(values):
        error, jacobians = residual.function(values)
        moves = [motion(library, m, v) for m, v in zip(residual.manifolds, values, strict=True)]
        return error, [j @ move for j, move in zip(jacobians, moves, strict=True)]

    return residual._replace(function=function)


def of_ceres(rng, order="wxyz", **scales):
    """The reprojection with blocks quaternion, translation, point and lens, by all numbers."""
    plain = reprojection(rng, **scales)
    places = [3, 0, 1, 2] if order == "wxyz" else [0, 1, 2, 3]

    def function(values):
        quaternion, t, point, lens = values
        q = np.empty(4)
        q[places] = quaternion
        # Where |q| is not 1, this is the polynomial that Eigen evaluates.
        u, w = q[:3], q[3]
        by_w = skew(u) @ point
        turned = point + 2 * w * by_w + 2 * skew(u) @ by_w
        x, y, z = turned + t
        p = np.array([x, y]) / z
        f, k = lens
        square = p @ p
        bend = (1 + k * square) * np.eye(2) + 2 * k * np.outer(p, p)
        by_seen = f * bend @ np.array([[1, 0, -p[0]], [0, 1, -p[1]]]) / z
        by_u = -2 * w * skew(point) - 2 * (skew(by_w) + skew(u) @ skew(point))
        by_q = np.column_stack([by_u, 2 * by_w])[:, places]
        by_point = np.eye(3) + 2 * w * skew(u) + 2 * skew(u) @ skew(u)
        by_lens = np.column_stack([(1 + k * square) * p, f * square * p])
        return f * (1 + k * square) * p, [by_seen @ by_q, by_seen, by_seen @ by_point, by_lens]

    pose, point, lens = plain.values
    values = [pose[:4][places], pose[4:], point, lens]
    return Residual(function, values, [f"quaternion_{order}", None, None, None])


def angle_axis(rng, **scales):
    """The reprojection with a rotation vector, as Ceres' bundle adjustment example."""
    plain = reprojection(rng, **scales)
    pose, point, lens = plain.values

    def function(values):
        w, t, point, lens = values
        q = Rotation.from_rotvec(w).as_quat()
        error, (by_pose, by_point, by_lens) = plain.function([np.append(q, t), point, lens])
        turn = Rotation.from_rotvec(w).as_matrix()
        by_turn = by_pose[:, :3] @ left_jacobian(-w)
        return error, [by_turn, by_pose[:, 3:] @ turn.T, by_point, by_lens]

    values = [Rotation.from_quat(pose[:4]).as_rotvec(), pose[4:], point, lens]
    return Residual(function, values, ["angle_axis", None, None, None])
