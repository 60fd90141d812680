"""Alignment of the poses of an estimate to those of a reference.

The alignment maps the world of the estimate to that of the reference, x -> s R x + t. Centres c_i
and their counterparts g_i determine it with equal weights:

| alignment | free | for |
|---|---|---|
| similarity | s, R, t | reconstructions from images, whose scale is free |
| rigid | R, t | estimates with a scale |
| yaw | rotation about z, t | visual-inertial odometry, which knows scale and gravity |
| none | | estimates in the frame of the reference |

Similarity and rigid motion are Umeyama's (``similarity``). The yaw a maximises the sum of g_i .
R_z(a) c_i over centred positions,

    tan a = sum (c_x g_y - c_y g_x) / sum (c_x g_x + c_y g_y).

If the centres lie on one line, the rotation about it is free, and no alignment is returned. If they
lie near a line, noise determines this rotation: residuals e_i of n centres at the distances d_i
from their line leave it uncertain by

    sigma = sqrt(sum |e_i|^2 / (3 n - 7)) / sqrt(sum d_i^2).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.georeference.similarity import Similarity, umeyama
from bundle.georeference.similarity_fit import THINNEST
from bundle.model.rigid_motions import quaternion_from_matrix, quaternion_multiply

SMALLEST = 1e-100  # length below which squares of coordinates lose digits

SMALLEST_SPREAD = 1e-12
"""Ratio of the spread of centres to their magnitude below which they are at one place."""

Array = NDArray[np.float64]


def align_centers(source: Array, target: Array, alignment: str = "similarity") -> Similarity:
    """Return the alignment of centres to those of a reference.

    If all centres are equal to their counterparts, the result is the identity, without rounding.

    Args:
        source: (n, 3) centres of the estimate.
        target: (n, 3) centres of the reference.
        alignment: "similarity", "rigid", "yaw" or "none".
    """
    if alignment == "none":
        return Similarity(1.0, np.eye(3), np.zeros(3))
    if alignment != "yaw":
        for name, points in (("a", source), ("b", target)):
            _check_spread(name, points)
    if np.array_equal(source, target):
        return Similarity(1.0, np.eye(3), np.zeros(3))
    center, goal = source.mean(axis=0), target.mean(axis=0)
    if alignment == "yaw":
        p, q = source - center, target - goal
        yaw = math.atan2(
            float(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])),
            float(np.sum(p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1])),
        )
        c, s = math.cos(yaw), math.sin(yaw)
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return Similarity(1.0, rotation, goal - rotation @ center)
    fitted = umeyama(source, target)
    if alignment == "similarity":
        return fitted
    return Similarity(1.0, fitted.rotation, goal - fitted.rotation @ center)


def _check_spread(name: str, points: Array) -> None:
    center = points.mean(axis=0)
    spread = np.linalg.svd(points - center, compute_uv=False)
    if not spread[0] > SMALLEST_SPREAD * max(float(np.abs(center).max()), SMALLEST):
        raise InputError(
            f"{name}: expected shared poses at different places, found all {len(points)} at one "
            "place"
        )
    if spread[1] <= THINNEST * spread[0]:
        raise InputError(
            f"{name}: the {len(points)} shared centres lie on one line, so that the rotation about "
            f"it is undetermined: expected a centre beside the line, or align=yaw or align=none"
        )


def moved_poses(poses: Array, similarity: Similarity) -> Array:
    """Return poses world_from_camera (n, 7) after a similarity of the world."""
    turn = quaternion_from_matrix(similarity.rotation[None])
    turned = quaternion_multiply(np.broadcast_to(turn, (len(poses), 4)), poses[:, :4])
    return np.hstack([turned, similarity.apply(poses[:, 4:])])


def angle_about_line(target: Array, residuals: Array) -> tuple[float, float]:
    """Return the uncertainty of the rotation about the line nearest to centres.

    ``target``: (n, 3) centres of the reference. ``residuals``: (n,) lengths of the residuals after
    the alignment.

    Returns:
        Standard deviation of the rotation in radians, and the ratio of width to length of the
        centres.
    """
    spread = np.linalg.svd(target - target.mean(axis=0), compute_uv=False)
    across = math.sqrt(float((spread[1:] ** 2).sum()))
    unit = float(residuals.max()) or 1.0
    squares = float(((residuals / unit) ** 2).sum())
    noise = unit * math.sqrt(squares / max(3 * len(target) - 7, 1))
    ratio = across / spread[0] if spread[0] > 0 else 0.0
    return (noise / across if across > 0 else math.inf), float(ratio)
