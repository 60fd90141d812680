"""Mistakes of Jacobians in the layouts of Ceres, GTSAM, manif and g2o, and their names.

A mistake changes right Jacobians in the coordinates of its library.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tests.campaigns.library_residuals import (
    Residual,
    adjoint,
    align,
    angle_axis,
    bearing,
    between,
    homogeneous,
    motion,
    of_ceres,
    reprojection,
    right_jacobian,
    sighting,
)
from tests.checking.reprojection import left_jacobian, skew

DEGREE = np.pi / 180
REORDERED = [3, 4, 5, 0, 1, 2]


class Mistake(NamedTuple):
    """A mistake: its layout, its residual, the change of the Jacobians, and its names."""

    library: str
    name: str
    make: Callable[..., Residual]
    spoil: Callable[..., list]
    kinds: frozenset[str]


# Changes: (values, Jacobians, error) -> Jacobians.


def of_block(b, change):
    """A change of one Jacobian, which may use the value of its variable."""

    def spoil(values, jacobians, _error):
        wrong = list(jacobians)
        wrong[b] = change(wrong[b], values[b])
        return wrong

    return spoil


def columns(b, chosen, factor):
    """Some columns of a Jacobian times a factor."""

    def change(jacobian, _value):
        wrong = jacobian.copy()
        wrong[:, chosen] *= factor
        return wrong

    return of_block(b, change)


def of_motion(library, b, wrong, manifold="se3"):
    """A Jacobian by another motion: M_e^-1 M_w, M_w by the function `wrong` of the value."""

    def change(jacobian, value):
        return jacobian @ np.linalg.solve(motion(library, manifold, value), wrong(value))

    return of_block(b, change)


def left(value):
    """By d of Exp(d) X."""
    return adjoint(np.linalg.inv(homogeneous(value)))


def blocks(first, second):
    matrix = np.zeros((6, 6))
    matrix[:3, :3], matrix[3:, 3:] = first, second
    return matrix


def back(value):
    return Rotation.from_quat(value[:4]).as_matrix().T


def world(value):
    """By d of R Exp(w), t + v."""
    return blocks(np.eye(3), back(value))


def split(value):
    """By d of Exp(w) R, t + v."""
    return blocks(back(value), back(value))


def first_translation(matrix):
    return lambda value: matrix(value)[:, REORDERED]


def plane(value):
    """By d of t + v in the plane."""
    c, s = np.cos(value[2]), np.sin(value[2])
    matrix = np.eye(3)
    matrix[:2, :2] = [[c, s], [-s, c]]
    return matrix


def swapped_blocks(a, b):
    def spoil(_values, jacobians, _error):
        wrong = list(jacobians)
        wrong[a], wrong[b] = wrong[b], wrong[a]
        return wrong

    return spoil


def of_rows(order):
    return lambda _values, jacobians, _error: [jacobian[order] for jacobian in jacobians]


def without_adjoint(_values, jacobians, _error):
    """J_i = -J_j."""
    return [-jacobians[1], jacobians[1]]


def inverse_adjoint(library):
    """J_i = -J_j Ad(X_i^-1 X_j) instead of Ad(X_j^-1 X_i)."""

    def spoil(values, jacobians, _error):
        relative = np.linalg.inv(homogeneous(values[0])) @ homogeneous(values[1])
        moves = [motion(library, "se3", value) for value in values]
        by_second = jacobians[1] @ np.linalg.inv(moves[1])
        return [-by_second @ adjoint(relative) @ moves[0], jacobians[1]]

    return spoil


def of_logarithm(matrix):
    """Rows of J_r^-1 replaced: J_r^-1 (e) A to M(e) A."""

    def spoil(_values, jacobians, error):
        change = matrix(error) @ right_jacobian(error)
        return [change @ jacobian for jacobian in jacobians]

    return spoil


def float32(_values, jacobians, _error):
    return [jacobian.astype(np.float32).astype(float) for jacobian in jacobians]


def weighted(make, weights):
    """A residual with weights."""

    def made(rng, **scales):
        plain = make(rng, **scales)
        size = len(plain.function(plain.values)[0])
        matrix = weights(rng, size)

        def function(values):
            error, jacobians = plain.function(values)
            return matrix @ error, [matrix @ jacobian for jacobian in jacobians]

        function.weights = matrix
        return plain._replace(function=function)

    return made


def full(rng, size):
    return np.linalg.cholesky(np.diag(10.0 ** rng.uniform(0, 2, size)) + np.ones((size, size))).T


def without_weights(_values, jacobians, _error, function):
    return [np.linalg.solve(function.weights, jacobian) for jacobian in jacobians]


def twice_weighted(_values, jacobians, _error, function):
    return [function.weights.T @ jacobian for jacobian in jacobians]


def divided_by_focal(values, jacobians, _error):
    """The focal length is missing in the chain rule of all blocks but the lens."""
    return [*(jacobian / values[-1][0] for jacobian in jacobians[:-1]), jacobians[-1]]


def without_distortion(values, jacobians, _error, function):
    """The chain rule of pose and point ignores the distortion."""
    plain = [*values[:-1], values[-1] * [1, 0]]
    return [*function(plain)[1][:-1], jacobians[-1]]


def padded(values, jacobians, _error):
    """The Jacobian by a left rotation, with a zero column, in place of that by a quaternion."""
    w, x, y, z = values[0]
    seen = Rotation.from_quat([x, y, z, w]).apply(values[2])
    local = -jacobians[1] @ skew(seen)
    return [np.hstack([local, np.zeros((2, 1))]), *jacobians[1:]]


def column_major(b):
    return of_block(b, lambda jacobian, _: jacobian.T.reshape(jacobian.shape))


def at_perturbation(values, jacobians, _error):
    """By d of Exp(d) Exp(w) in place of by w."""
    return [jacobians[0] @ np.linalg.inv(left_jacobian(values[0])), *jacobians[1:]]


def right_for_left(values, jacobians, _error):
    w = values[0]
    change = np.linalg.solve(left_jacobian(w), left_jacobian(-w))
    return [jacobians[0] @ change, *jacobians[1:]]


def without_rotation(values, jacobians, _error):
    """The Jacobian by the point lacks R."""
    return [jacobians[0], jacobians[1] @ back(values[0]), *jacobians[2:]]


def roll(step):
    return of_block(0, lambda jacobian, _: np.roll(jacobian, step, axis=1))


def zero(b, chosen):
    return columns(b, chosen, 0)


def listed() -> list[Mistake]:
    """Return the mistakes."""
    found: list[Mistake] = []

    def add(library, name, make, spoil, *kinds):
        found.append(Mistake(library, name, make, spoil, frozenset(kinds)))

    eigen = partial(of_ceres, order="xyzw")
    add("ceres", "x y z w for w x y z", of_ceres, roll(-1), "quaternion_order")
    add("ceres", "w x y z for x y z w", eigen, roll(1), "quaternion_order")
    add("ceres", "local Jacobian, padded", of_ceres, padded, "padded")
    add("ceres", "column-major point", of_ceres, column_major(2), "transposed")
    add("ceres", "sign of z", of_ceres, columns(2, [2], -1), "sign")
    add("ceres", "point and translation swapped", of_ceres, swapped_blocks(1, 2), "swapped_blocks")
    add("ceres", "factor 2 of the quaternion", of_ceres, columns(0, slice(None), 0.5), "factor")
    add("ceres", "no focal length", of_ceres, divided_by_focal, "scaled_by_parameter")
    add("ceres", "no distortion", of_ceres, without_distortion, "missing_term")
    add("ceres", "float32", of_ceres, float32, "float_precision")
    add("ceres", "no J_l", angle_axis, at_perturbation, "perturbation")
    add("ceres", "J_r for J_l", angle_axis, right_for_left, "perturbation")
    add("ceres", "degrees", angle_axis, columns(0, slice(None), DEGREE), "degrees")

    for library in ("gtsam", "manif", "g2o"):
        first = first_translation if library != "gtsam" else lambda matrix: matrix
        half = np.diag([2, 2, 2, 1, 1, 1]) if library == "g2o" else np.eye(6)

        def by(matrix, first=first, half=half):
            return first(lambda value: matrix(value) @ half)

        of = partial(of_motion, library, 0)
        add(library, "left for right", sighting, of(by(left)), "perturbation")
        add(library, "the translation of the world", sighting, of(by(world)), "frame")
        add(library, "rotation and translation of the world", reprojection, of(by(split)),
            "perturbation")  # fmt: skip
        add(library, "the inverse pose", reprojection, of(by(lambda v: -left(v))), "inverse")
        other = of_block(0, lambda jacobian, _: jacobian[:, REORDERED])
        add(library, "wrong order", sighting, other, "order")
        add(library, "blocks swapped", between, swapped_blocks(0, 1), "swapped_blocks")
        add(library, "no adjoint", between, without_adjoint, "adjoint")
        add(library, "inverse adjoint", between, inverse_adjoint(library), "adjoint")
        add(library, "no J_r^-1", between, of_logarithm(lambda _: np.eye(6)), "logarithm")
        add(library, "J_l^-1 for J_r^-1", between,
            of_logarithm(lambda e: np.linalg.inv(right_jacobian(-e))), "logarithm")  # fmt: skip
    add("gtsam", "degrees in the plane", bearing, columns(0, [2], DEGREE), "degrees")
    add("gtsam", "angle first", bearing, of_block(0, lambda j, _: j[:, [2, 0, 1]]), "order")
    add("gtsam", "the translation of the world in the plane", bearing,
        of_motion("gtsam", 0, plane, "se2"), "frame")  # fmt: skip
    add("manif", "half the rotation", sighting, columns(0, slice(3, 6), 2), "half_angle")
    add("manif", "rows of rotation and translation", between, of_rows(REORDERED), "swapped_rows")
    add("manif", "a left rotation", align, of_block(0, lambda j, v: j @ back(v)), "perturbation")
    add("g2o", "rotation vector", sighting, columns(0, slice(3, 6), 0.5), "half_angle")
    add("g2o", "the frame of the body in the plane", bearing,
        of_motion("g2o", 0, lambda _: np.eye(3), "se2"), "frame")  # fmt: skip
    add("g2o", "no weights", weighted(between, full), without_weights, "whitening")
    add("g2o", "the transposed root", weighted(sighting, full), twice_weighted, "whitening")

    of = partial(of_motion, "g2o_expmap", 0)
    expmap = "g2o_expmap"
    add(expmap, "right for left", reprojection, of(lambda _: np.eye(6)), "perturbation")
    add(expmap, "translation first", reprojection,
        of_block(0, lambda j, _: j[:, REORDERED]), "order")  # fmt: skip
    add(expmap, "t + d", reprojection, of(split), "frame")
    add(expmap, "half the rotation", reprojection, columns(0, slice(0, 3), 2), "half_angle")
    add(expmap, "no R for the point", reprojection, without_rotation, "frame")
    add(expmap, "sign of a block", reprojection, columns(0, slice(None), -1), "sign")
    add(expmap, "sign of a column", reprojection, columns(0, [4], -1), "sign")
    add(expmap, "no focal length", reprojection, divided_by_focal, "scaled_by_parameter")
    add(expmap, "u and v swapped", reprojection, of_rows([1, 0]), "swapped_rows")
    add(expmap, "transposed", align, of_block(1, lambda j, _: j.T), "transposed")
    add(expmap, "no derivative by y", reprojection, zero(1, [1]), "zero")
    add(expmap, "degrees", reprojection, columns(0, slice(0, 3), DEGREE), "degrees")
    add(expmap, "no distortion", reprojection, without_distortion, "missing_term")
    return found
