"""Offset between the clocks of the images and of the IMU, from rotations.

Let dR_k(d) be the rotation of the IMU from its samples between t_k + d and t_(k+1) + d, and B_k the
same rotation from the poses of the images, without noise equal at the offset d of the clocks. With
w_k the rate at t_k + d,

    dR_k(d + x) = Exp(-w_k x) dR_k Exp(w_(k+1) x) = dR_k Exp((w_(k+1) - dR_k^T w_k) x)

to first order. A step (y, x) of the gyroscope's bias and of d thus changes the residual by

    Log(dR_k^T B_k) - J_k y - (w_(k+1) - dR_k^T w_k) x,        J_k: derivative of dR_k by the bias,

and Gauss-Newton steps with Cauchy weights find both. A change of the rate determines the offset: a
constant rate does not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.model.rigid_motions import quaternion_from_matrix, vector_from_quaternion

Array = NDArray[np.float64]

STEPS = 10
MOST = 0.1
"""Largest offset in seconds: the model is linear in it."""
SMALL_STEP = 1e-7
CLEAR = 5.0
"""Number of sigmas from which an offset counts. The errors of poses are correlated."""


class ClockOffset(NamedTuple):
    """Offset in seconds that is added to the times of images, and its standard deviation."""

    seconds: float = 0.0
    sigma: float = math.inf

    @property
    def is_clear(self) -> bool:
        """True if the offset is not a result of noise."""
        return abs(self.seconds) > CLEAR * self.sigma


def clock_offset(
    between: Array,
    motions_at: Callable[[float, Array], list[Preintegration]],
    rates_at: Callable[[float], Array],
) -> ClockOffset:
    """Return the offset of n images; without one that is determined, its sigma is infinite.

    Args:
        between: (n - 1, 3, 3) rotations of the IMU between the images, R_k^T R_(k+1).
        motions_at: motions between the images at an offset and a gyroscope's bias.
        rates_at: (n, 3) measured rates at the images, at an offset.
    """
    offset, bias = 0.0, np.zeros(3)
    for _ in range(STEPS):
        motions = motions_at(offset, bias)
        deltas = np.array([motion.delta_rotation for motion in motions])
        errors = vector_from_quaternion(quaternion_from_matrix(np.swapaxes(deltas, 1, 2) @ between))
        rates = rates_at(offset) - bias
        by_offset = rates[1:] - np.einsum("nji,nj->ni", deltas, rates[:-1])
        by_bias = np.array([motion.d_rotation_d_gyro_bias for motion in motions])
        rows = np.concatenate([by_bias, by_offset[:, :, None]], axis=2)
        lengths = np.linalg.norm(errors, axis=1)
        weights = 1 / (1 + (lengths / (2 * np.median(lengths) + 1e-12)) ** 2)
        normal = np.einsum("n,nji,njk->ik", weights, rows, rows)
        if not np.linalg.cond(normal) < 1e14:
            return ClockOffset()
        step = np.linalg.solve(normal, np.einsum("n,nji,nj->i", weights, rows, errors))
        bias, offset = bias + step[:3], offset + float(step[3])
        if not abs(offset) < MOST:
            return ClockOffset()
        if abs(step[3]) < SMALL_STEP:
            break
    else:
        return ClockOffset()
    variance = float((weights * lengths**2).sum() / (3 * weights.sum()))
    covariance = variance * np.linalg.inv(normal)
    return ClockOffset(offset, math.sqrt(covariance[3, 3]))
