r"""Linear map between the rotations of a gyroscope and of images, and axes of an accelerometer.

Let c_k be the rotation vector of the IMU between two images by their poses and camera_from_imu, g_k
that of the integrated samples, and T_k the time between. Right axes give c = g + T b with the bias
b. Any other axes or units give

    c_k = M g_k + T_k b,

by linear least squares with Cauchy weights. The polar decomposition M = Q S identifies the error:

    det Q < 0     the gyroscope has reversed axes, or its axes are left-handed
    Q             camera_from_imu, whose rotation C should be C Q, or the axes of the IMU
    S             the unit or the scale of the rates

Rotations do not depend on the scale of a model, and images alone determine them without drift.
"""

from __future__ import annotations

import dataclasses
import math
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.inertial.offline.inertial_start import InertialStart, gyro_bias, solve_inertial_start
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.rigid_motions import (
    quaternion_from_matrix,
    rotation_matrices,
    vector_from_quaternion,
)
from bundle.model.sequence.calibration import ImuNoise

Array = NDArray[np.float64]

STEPS = 20
DETERMINED = 0.1  # standard deviation of a column up to which the map reveals an error of axes
EXPLAINED = 0.5  # residual with the map over that without it, below which it is an explanation
TURNED, NEAR = 15.0, 12.0  # degrees from which axes are wrong; within which a named error is one
SIGMAS, ANGLE, SCALE = 5.0, 1.0, 0.02  # sigmas, degrees, relative scale from which an error counts


class RotationMap(NamedTuple):
    """Map of rotation vectors, with the standard deviations of its columns."""

    matrix: Array  # M
    sigma: Array  # (3,) standard deviation of the entries of each column
    rms: float  # root mean square of the residual, rad
    rms_before: float  # the same for the identity instead of M

    @staticmethod
    def between(between: Array, motions: list[Preintegration], unit: float = 1.0) -> RotationMap:
        """Return the map of (n, 3, 3) rotations between images and their motions.

        ``unit`` is the factor on the rates of the motions.
        """
        images = vector_from_quaternion(quaternion_from_matrix(between))
        deltas = np.array([motion.delta_rotation for motion in motions])
        samples = vector_from_quaternion(quaternion_from_matrix(deltas)) / unit
        times = np.array([motion.duration for motion in motions])[:, None]
        rows = np.hstack([samples, times])
        found, normal, rms = _fit(rows, images)
        before = _fit(times, images - samples)[2]
        sigma = rms * np.sqrt(np.diag(np.linalg.pinv(normal))[:3])
        return RotationMap(found[:3].T, sigma, rms, before)

    @property
    def rotation(self) -> Array:
        """(3, 3) Q, with determinant 1 or -1."""
        u, _, vt = np.linalg.svd(self.matrix)
        return np.asarray(u @ vt)

    @property
    def scale(self) -> float:
        """Mean of the singular values."""
        return float(np.linalg.svd(self.matrix, compute_uv=False).mean())

    @property
    def angle(self) -> float:
        """Angle of Q, or of -Q if that is the rotation, in degrees."""
        rotation = self.rotation
        return _degrees(rotation * np.linalg.det(rotation))

    @property
    def turn(self) -> Array:
        """Rotation vector (3,) of Q, or of -Q if that is the rotation, in rad."""
        rotation = self.rotation * np.linalg.det(self.rotation)
        turned: Array = vector_from_quaternion(quaternion_from_matrix(rotation[None]))[0]
        return turned

    @property
    def angle_sigma(self) -> float:
        """Standard deviation of the angle in degrees."""
        return math.degrees(float(self.sigma.max()))

    @property
    def is_determined(self) -> bool:
        """True if the motion turns about all axes."""
        return bool((self.sigma < DETERMINED).all())

    @property
    def is_turned(self) -> bool:
        """True for a clear error of camera_from_imu, of any size."""
        return self.is_determined and self.angle > max(ANGLE, SIGMAS * self.angle_sigma)

    @property
    def is_scaled(self) -> bool:
        """True for a clear error of the scale of rates."""
        sigma = float(np.sqrt((self.sigma**2).mean() / 3))
        return self.is_determined and abs(self.scale - 1) > max(SCALE, SIGMAS * sigma)

    def cause(self, camera_from_imu: Array) -> tuple[str, str]:
        """Return the kind ("inverse", "gyro_scale", ...) and a sentence of a gross error."""
        explains = self.rms < EXPLAINED * self.rms_before
        if not (self.is_determined and explains):
            return "", ""
        q, right = self.rotation, rotation_matrices(camera_from_imu[None, :4])[0]
        if np.linalg.det(q) > 0:
            if not 0.5 < self.scale < 2:
                found = "rates of another unit (degrees per second?)"
                if self.scale > 2:
                    found = f"{1 / self.scale:.2g} of them"
                words = f"expected rates in rad/s that agree with the images, found {found}"
                return "gyro_scale", words
            if self.angle < TURNED:
                return "", ""
            if _degrees(right.T @ (right @ q).T) < NEAR:
                return "inverse", "camera_from_imu is given inverted, as imu_from_camera"
            x, y, z, w = camera_from_imu[:4]
            ordered = rotation_matrices(np.array([[y, z, w, x]]))[0]
            if _degrees(ordered.T @ right @ q) < NEAR:
                words = "the quaternion of camera_from_imu has the order w x y z, not x y z w"
                return "order", words
        axes = signed_axes(q)
        if axes is not None:
            return "gyro_axes", axes_sentence("gyroscope", axes)
        if np.linalg.det(q) < 0:
            return "gyro_axes", "the gyroscope is mirrored: an axis is reversed"
        return "camera_from_imu", (
            f"the rotation of camera_from_imu is off by {self.angle:.1f} +- "
            f"{self.angle_sigma:.1g} degrees"
        )


def signed_axes(matrix: Array) -> Array | None:
    """Return the signed permutation near an orthogonal matrix; None if none is near."""
    axes = np.zeros((3, 3))
    order = np.abs(matrix).argmax(axis=1)
    axes[range(3), order] = np.sign(matrix[range(3), order])
    if sorted(order.tolist()) != [0, 1, 2] or _degrees(axes.T @ matrix) > NEAR:
        return None
    return axes


def axes_sentence(sensor: str, axes: Array) -> str:
    """Return a sentence on a sensor whose axes are a signed permutation, such as +y -x +z."""
    order = np.abs(axes).argmax(axis=1)
    signs = axes[range(3), order]
    words = " ".join("-+"[int(s > 0)] + "xyz"[k] for s, k in zip(signs, order, strict=True))
    kind = "turned" if np.linalg.det(axes) > 0 else "mirrored"
    if np.array_equal(axes, -np.eye(3)):
        kind = "reversed"
    return f"the {sensor} is {kind}: its axes are {words} in the frame of camera_from_imu"


def _fit(rows: Array, values: Array) -> tuple[Array, Array, float]:
    """Return the coefficients, their normal matrix, and the weighted rms, with Cauchy weights."""
    weights = np.ones(len(rows))
    for _ in range(STEPS):
        normal = (rows * weights[:, None]).T @ rows
        found = np.linalg.pinv(normal) @ ((rows * weights[:, None]).T @ values)
        lengths = np.linalg.norm(values - rows @ found, axis=1)
        rms = math.sqrt(float((weights * lengths**2).sum() / (3 * weights.sum())))
        weights = 1 / (1 + (lengths / (2 * np.median(lengths) + 1e-12)) ** 2)
    return found, normal, rms


def _degrees(rotation: Array) -> float:
    cosine = (float(np.trace(rotation)) - 1) / 2
    return math.degrees(math.acos(min(1.0, max(-1.0, cosine))))


# Axes of an accelerometer by the path of the images.
#
# The equations of ``inertial_start`` are linear in the forces. For each of the 24 right-handed
# choices of axes A, forces A a give a scale of either sign; a negative one is the positive one of
# -A. The choice with the least residual gives the axes, if it leaves at most half of the residual
# of the given axes, or these give a negative scale.


MOST_SCALE_SIGMA = 0.1


def accel_axes(
    rotations: Array,
    centers: Array,
    arms: Array,
    intervals: list[ImuInterval],
    noise: ImuNoise,
    gravity: float,
    rule: str,
) -> tuple[Array, InertialStart] | None:
    """Return the axes that explain the path and the start with the given axes, or None."""
    found: list[tuple[float, Array, InertialStart]] = []
    between = np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]
    bias = gyro_bias(between, intervals, noise, rule)
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            axes = np.zeros((3, 3))
            axes[range(3), order] = signs
            if np.linalg.det(axes) < 0:
                continue
            turned = [
                dataclasses.replace(interval, accel=interval.accel @ axes.T)
                for interval in intervals
            ]
            start = solve_inertial_start(
                rotations, centers, arms, turned, noise, gravity, rule, bias
            )
            found.append((start.rms, axes, start))
    given = found[0]  # the identity is the first permutation with the first signs
    best = min(found, key=lambda one: one[0])
    axes = best[1] if best[2].scale > 0 else -best[1]
    is_clear = best[0] < EXPLAINED * given[0] or given[2].scale < 0
    if np.array_equal(axes, np.eye(3)) or not is_clear or best[2].scale_sigma > MOST_SCALE_SIGMA:
        return None
    return axes, given[2]
