"""Rotation of the camera between two images, from corresponding rays by Gauss-Newton.

Rays x and y of one point satisfy y . (t x R x) = 0 (coplanarity). With v = R x, left perturbation
R <- Exp(w) R and t <- t + d, the derivatives are

    d e / d w  =  y (t . v) - t (y . v),        d e / d t  =  v x y.

e is divided by the length of its gradient with respect to both image points (Sampson, 1982), which
makes it a distance on the image plane. Weights are Cauchy's. t moves on the unit sphere: d is
perpendicular to it. Without translation, t is arbitrary and R still determined; a small damping
keeps the step finite. The Schur complement of d in the normal matrix is the information on w: small
where a rotation and a translation move the rays in the same way.

A rotation and a translation move rays in similar ways, so that there are several minima. The
search begins at two starts and returns the minimum with the lowest Cauchy cost.

* Rotation by the samples, near the right minimum unless axes or units are wrong. The direction of
  the translation is then perpendicular to the normals of the planes through corresponding rays.
* Essential matrix E by linear least squares on y^T E x = 0 (Longuet-Higgins, 1981), which ignores
  that two of its singular values are equal and the third is 0. With E = U S V^T, the smaller of the
  two rotations U W V^T, in which W is a quarter of a turn to either side; t is the last column of
  U. Points on a plane do not determine E.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.rigid_motions import cross_rows, quaternion_from_vector, rotation_matrices
from bundle.model.sequence.calibration import Calibration

Array = np.ndarray[Any, Any]

STEPS = 6
DAMPING = 1e-6  # of the trace of the normal matrix
APART = 0.25  # s between the images of a pair
FEWEST = 12  # common tracks


class Turn(NamedTuple):
    """Rotation of the camera between two images, by their tracks."""

    earlier: int  # stamps of the images on the IMU's clock, ns
    later: int
    rotation: Array  # (3, 3), later_from_earlier
    information: Array  # (3, 3) on a small rotation of the later image


def refined_rotation(
    one: Array, other: Array, rotation: Array, direction: Array, sigma: float
) -> tuple[Array, Array, float]:
    """Return the best rotation (3, 3) other_from_one, the information (3, 3) on it, and the cost.

    ``one``, ``other`` and ``sigma`` are in normalised coordinates; ``rotation`` and ``direction``
    of the translation are initial values.
    """
    ones = np.ones((len(one), 1))
    x, y = np.hstack([one, ones]), np.hstack([other, ones])
    t = np.asarray(direction, np.float64).ravel()
    t = t / np.linalg.norm(t)
    for _ in range(STEPS):
        v = x @ rotation.T
        essential = cross_rows(t, rotation.T).T  # [t]x R
        lines = np.hstack([(x @ essential.T)[:, :2], (y @ essential)[:, :2]])
        length = np.maximum(np.linalg.norm(lines, axis=1), 1e-12)
        error = np.einsum("ni,ni->n", y, cross_rows(t, v)) / length
        tangent = np.linalg.svd(t[None])[2][1:]  # (2, 3)
        by_turn = y * (v @ t)[:, None] - t * np.einsum("ni,ni->n", y, v)[:, None]
        by_direction = cross_rows(v, y) @ tangent.T
        jacobian = np.hstack([by_turn, by_direction]) / length[:, None]
        weight = 1 / (1 + (error / sigma) ** 2)
        normal = jacobian.T @ (weight[:, None] * jacobian)
        normal += DAMPING * np.trace(normal) * np.eye(5)
        step = -np.linalg.solve(normal, jacobian.T @ (weight * error))
        rotation = rotation_matrices(quaternion_from_vector(step[None, :3]))[0] @ rotation
        t = t + step[3:] @ tangent
        t = t / np.linalg.norm(t)
    by_both = np.linalg.solve(normal[3:, 3:], normal[3:, :3])
    information = (normal[:3, :3] - normal[:3, 3:] @ by_both) / sigma**2
    return rotation, information, float(-np.log(weight).sum())


def linear_rotation(x: Array, y: Array) -> tuple[Array, Array]:
    """Return an approximate rotation (3, 3) and direction of the translation between unit rays."""
    rows = (y[:, :, None] * x[:, None, :]).reshape(-1, 9)
    essential = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    errors = np.abs(rows @ essential.ravel())
    weights = 1 / (1 + (errors / (2 * np.median(errors) + 1e-15)) ** 2)
    u, _, vt = np.linalg.svd(np.linalg.svd(weights[:, None] * rows)[2][-1].reshape(3, 3))
    found = []
    for sign in (1.0, -1.0):
        rotation = u @ np.array([[0, -sign, 0], [sign, 0, 0], [0, 0, 1]]) @ vt
        found.append(rotation * np.sign(np.linalg.det(rotation)))
    return max(found, key=np.trace), u[:, 2]


def turns_of_tracks(images: SequenceImages, most: int, apart: float = APART) -> list[Turn]:
    """Return rotations between at most ``most`` pairs of images, ``apart`` seconds apart."""
    stamps, covered = images.stamps, np.flatnonzero(images.covered)
    sigma = images.sequence.calibration.pixel_sigma / images.sequence.calibration.focal
    earlier = covered
    if len(earlier) > most:
        earlier = earlier[np.linspace(0, len(earlier) - 1, most).round().astype(int)]
    turns = []
    for first in earlier.tolist():
        second = int(np.searchsorted(stamps, stamps[first] + round(1e9 * apart)))
        if second > covered[-1]:
            break
        one, other = images.tracks(first), images.tracks(second)
        _, a, b = np.intersect1d(one.ids, other.ids, assume_unique=True, return_indices=True)
        if len(a) < FEWEST or stamps[second] - stamps[first] > 2e9 * apart:
            continue
        rays = [np.column_stack([xy, np.ones(len(xy))]) for xy in (one.xy[a], other.xy[b])]
        x, y = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in rays)
        interval = images.interval(int(stamps[first]), second)
        rotation = turn_of_samples(interval, images.sequence.calibration)
        direction = np.linalg.svd(cross_rows(y, x @ rotation.T))[2][2]
        found = [
            refined_rotation(one.xy[a], other.xy[b], turned, shift, sigma)
            for turned, shift in ((rotation, direction), linear_rotation(x, y))
        ]
        best = min(found, key=lambda each: each[2])
        turns.append(Turn(int(stamps[first]), int(stamps[second]), *best[:2]))
    return turns


def turn_of_samples(interval: ImuInterval, calibration: Calibration) -> Array:
    """Return the rotation of the camera, later_from_earlier, by the gyroscope."""
    motion = Preintegration(calibration.noise)
    motion.integrate(interval.gyro, interval.accel, interval.dt)
    lens = rotation_matrices(np.array(calibration.camera_from_imu)[None, :4])[0]
    turn: Array = lens @ motion.delta_rotation.T @ lens.T
    return turn
