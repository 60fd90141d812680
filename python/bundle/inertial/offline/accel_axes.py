"""Axes of an accelerometer by the path of the images.

The equations of ``inertial_start`` are linear in the forces. For each of the 24 right-handed
choices of axes A, forces A a give a scale of either sign; a negative one is the positive one of
-A. The choice with the least residual tells the axes, if it leaves at most half of the residual of
the given axes, or these give a negative scale.
"""

from __future__ import annotations

import dataclasses
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from bundle.inertial.offline.inertial_start import InertialStart, gyro_bias, solve_inertial_start
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.sequence.calibration import ImuNoise

Array = NDArray[np.float64]

EXPLAINED = 0.5
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
    """Return the axes that explain the path, and the start with the given ones, or None.

    The arguments are those of :func:`solve_inertial_start`.
    """
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
