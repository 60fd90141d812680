"""Agreement of images and IMU: chi2 of the adjustment and of each interval, and their clocks.

Whole adjustment. Let C be the cost of images and IMU together, and C_0 that of the images alone at
their own minimum. If both agree, 2 (C - C_0) is chi2 with 6 degrees of freedom for each interval: 9
of its motion and 6 of its random walks, less 3 of a velocity and 6 of the biases that each image
adds. The IMU's noise includes its factor for vibration, so that healthy recordings stay below. By
a bounded loss, an adjustment rejects observations that contradict the IMU: for such losses, and for
images alone that do not converge, C and C_0 are costs of the Cauchy loss.

Intervals. The motion and the random walks of interval k have chi2_k with at most 15 degrees of
freedom. As the factor for vibration is a guess, the variance factor v of this recording is taken
from the median: v = median chi2_k / median of chi2(6), between the inverse square of the factor for
vibration and 1. An interval is wrong if chi2_k / v exceeds the quantile that the largest of n good
ones exceeds with a probability of 0.1 %.

Causes. The rotations of images alone and of the gyroscope reveal errors of axes (``rotation_map``),
and errors of single times: a time of image k that is off by x_k changes the rotation between images
by w_{k+1} x_{k+1} - dR^T w_k x_k (``clock_offset``). A drift is x_k in proportion to the time.
Without a drift, the x_k count as independent; the method of moments gives their variance. A wrong
pose of a single image has the residuals of a wrong time. The
second differences of samples bound their white noise: std / sqrt(6), times the root of the period
as a density.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.tails import chi2_bound, chi2_median
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.interface.option_fields import number
from bundle.model.losses import evaluate_loss
from bundle.model.problem import Problem
from bundle.model.residuals import reprojection_errors
from bundle.model.rigid_motions import quaternion_from_matrix, vector_from_quaternion
from bundle.model.sequence.calibration import ImuNoise
from bundle.model.sequence.sequence_findings import quietest_noise

Array = NDArray[np.float64]

FREEDOM, MOST_FREEDOM = 6, 15
BOUNDED = ("arctan", "tukey")  # losses
NOT_SEEN = 100.0  # px: error of an observation that has no projection
FALSE_ALARM = 1e-3  # probability of a false alarm in a run
LARGE_NOISE = 5.0  # calibrated over measured noise that is an error: samples never have less
JITTER, JITTER_SHARE = 1.5e-3, 0.5  # s, share of the residuals' variance, from which times err
WRONG_POSE = 4.0  # medians of the residuals to which those of single images are reduced
DRIFT, DRIFT_SIGMAS = 4e-3, 5.0  # seconds over the video, and sigmas, from which clocks drift


class Agreement(NamedTuple):
    """Agreement of an adjustment."""

    chi2: float  # 2 (C - C_0), over the variance of the images alone if that is above 1
    freedom: int  # degrees of freedom
    interval_chi2: Array  # (n,) of each interval
    variance: float  # v
    images_variance: float = 1.0  # variance factor of the images alone

    @staticmethod
    def of(
        costs: Array, count: int, cost: float, alone: tuple[float, float], noise_scale: float
    ) -> Agreement:
        """Return the agreement.

        ``costs``: of all motions, then for each bias of its walks and its first prior; ``cost``: C;
        ``alone``: C_0 and the variance factor of the images alone.
        """
        motions, gyro, accel = (costs[first : first + count] for first in (0, count, 2 * count + 1))
        intervals = 2 * (motions + gyro + accel)
        variance = float(np.median(intervals)) / chi2_median(FREEDOM)
        least = min(1.0, 1 / noise_scale**2)
        chi2 = 2 * (cost - alone[0]) / max(alone[1], 1.0)
        return Agreement(chi2, FREEDOM * count, intervals, min(max(variance, least), 1.0), alone[1])

    @property
    def bound(self) -> float:
        """Bound of chi2."""
        return chi2_bound(self.freedom, FALSE_ALARM)

    @property
    def is_contradicted(self) -> bool:
        """True if the whole adjustment costs more than noise explains."""
        return self.chi2 > self.bound

    @property
    def wrong_intervals(self) -> list[int]:
        """Intervals beyond their bound, the worst first."""
        count = len(self.interval_chi2)
        bound = self.variance * chi2_bound(MOST_FREEDOM, FALSE_ALARM / count)
        wrong = np.flatnonzero(self.interval_chi2 > bound)
        order = np.argsort(-self.interval_chi2[wrong], kind="stable")
        return [int(k) for k in wrong[order]]

    def asdict(self) -> Mapping[str, Any]:
        """Return the content of the JSON report."""
        return {
            "chi2": self.chi2,
            "chi2_freedom": self.freedom,
            "chi2_bound": self.bound,
            "interval_chi2": self.interval_chi2.tolist(),
            "variance_factor": self.variance,
        }


def cauchy_cost(problem: Problem, scale: float) -> float:
    """Return the cost of the observations under the Cauchy loss."""
    errors, behind = reprojection_errors(problem)
    errors = np.where(behind | np.isnan(errors), NOT_SEEN, errors)
    sigma = 1.0 if problem.observation_sigma is None else problem.observation_sigma
    return float(evaluate_loss("cauchy", scale, (errors / sigma) ** 2)[:, 0].sum()) / 2


class ClockErrors(NamedTuple):
    """Errors of the times of single images."""

    jitter: float = 0.0  # their standard deviation in seconds
    share: float = 0.0  # share of the squared difference between the rotations that they explain
    drift: float = 0.0  # difference of the rates of both clocks, seconds per second
    drift_sigma: float = math.inf  # its standard deviation

    @staticmethod
    def of(errors: Array, rates: Array, deltas: Array, times: Array) -> ClockErrors:
        """Return the errors of n images from (n - 1, 3) Log(dR^T B), n rates, dR, and seconds."""
        n = len(rates)
        rows = np.zeros((n - 1, 3, n))
        k = np.arange(n - 1)
        rows[k, :, k + 1] = rates[1:]
        rows[k, :, k] = -np.einsum("nji,nj->ni", deltas, rates[:-1])
        a, y = rows.reshape(-1, n), errors.reshape(-1)
        along = a @ (times - times.mean())
        if not (y.any() and along.any()):
            return ClockErrors()
        drift = float(along @ y / (along @ along))
        left = y - drift * along
        sigma = math.sqrt(float(left @ left / len(left) / (along @ along)))
        lengths = np.repeat(np.linalg.norm(left.reshape(-1, 3), axis=1), 3)
        left *= np.minimum(1.0, WRONG_POSE * np.median(lengths) / np.maximum(lengths, 1e-12))
        # Moments: y^T y and |A^T y|^2 of y = A x + e are linear in the variances of e and x.
        square = a.T @ a
        trace, norm = float(np.trace(square)), float((square**2).sum())
        moments = np.array([[len(left), trace], [trace, norm]])
        right = np.array([left @ left, ((a.T @ left) ** 2).sum()])
        variance = max(float(np.linalg.solve(moments, right)[1]), 0.0)
        share = min(variance * trace / float(left @ left), 1.0) if left.any() else 0.0
        return ClockErrors(math.sqrt(variance), share, drift, sigma)


NOISE_SCALE, AT_INTERVAL = 5.0, 0.25
"""Factor on the noise densities of data sheets, which do not include vibration, for images at this
interval in seconds."""


def noise_scale_of(stamps: NDArray[np.int64], given: float | None) -> float:
    """Return the factor on the noise densities.

    The errors of a tracked point are correlated from image to image: images at a higher rate hold
    more observations, but not more information. Without a smaller noise of the IMU, they would
    outweigh it.
    """
    if given is not None:
        return number("imu_noise_scale", given, above=0)
    interval = 1e-9 * float(np.median(np.diff(stamps)))
    return max(NOISE_SCALE * math.sqrt(interval / AT_INTERVAL), 1.0)


def noise_ratios(
    stamps: NDArray[np.int64], gyro: Array, accel: Array, noise: ImuNoise
) -> tuple[float, float]:
    """Return calibrated noise / noise of the samples, by sensor; 0 for samples without noise."""
    period = 1e-9 * float(np.median(np.diff(stamps)))
    found = []
    for values, density in zip((gyro, accel), noise.astuple()[:2], strict=True):
        second = np.abs(np.diff(values, 2, axis=0))
        shown = 1.4826 * float(np.median(second)) * math.sqrt(period / 6)
        found.append(density / shown if shown > 0 else 0.0)
    return found[0], found[1]


def quietest_ratio(stamps: NDArray[np.int64], gyro: Array, accel: Array, noise: ImuNoise) -> float:
    """Return the larger ratio of both sensors: least noise of the samples / calibrated noise."""
    period = 1e-9 * float(np.median(np.diff(stamps)))
    return max(
        quietest_noise(values, period) / density
        for values, density in zip((gyro, accel), noise.astuple()[:2], strict=True)
    )


# Offset between the clocks of the images and of the IMU, from rotations.
#
# Let dR_k(d) be the rotation of the IMU from its samples between t_k + d and t_(k+1) + d, and B_k
# the same rotation from the poses of the images, without noise equal at the offset d of the clocks.
# With w_k the rate at t_k + d,
#
#     dR_k(d + x) = Exp(-w_k x) dR_k Exp(w_(k+1) x) = dR_k Exp((w_(k+1) - dR_k^T w_k) x)
#
# to first order. A step (y, x) of the gyroscope's bias and of d thus changes the residual by
#
#     Log(dR_k^T B_k) - J_k y - (w_(k+1) - dR_k^T w_k) x,      J_k: d dR_k / d bias,
#
# and Gauss-Newton steps with Cauchy weights find both. A change of the rate determines the offset:
# a constant rate does not. Between two and five sigmas, an adjustment with the offset and one
# without it decide by their costs, to which the forces contribute.

STEPS = 40
MOST = 0.1  # largest offset in seconds: the model is linear in it
SMALL_STEP = 1e-7
DOUBTFUL, CLEAR = 2.0, 5.0  # sigmas from which an offset is tried, and counts: errors correlate


class ClockOffset(NamedTuple):
    """Offset in seconds that is added to the times of images, and its standard deviation."""

    seconds: float = 0.0
    sigma: float = math.inf
    lowers_cost: bool = False  # True if images and IMU together decide

    @property
    def is_clear(self) -> bool:
        """True if the offset is not a result of noise."""
        return self.lowers_cost or abs(self.seconds) > CLEAR * self.sigma

    @property
    def is_doubtful(self) -> bool:
        """True if the rotations alone neither confirm the offset nor explain it by noise."""
        return not self.is_clear and abs(self.seconds) > DOUBTFUL * self.sigma


def clock_offset(
    between: Array,
    motions_at: Callable[[float, Array], list[Preintegration]],
    rates_at: Callable[[float], Array],
) -> ClockOffset:
    """Return the offset of n images; without one that is determined, its sigma is infinite.

    ``between`` are (n - 1, 3, 3) R_k^T R_(k+1) of the IMU; ``motions_at`` returns motions at an
    offset and a gyroscope's bias, ``rates_at`` measured rates (n, 3) at an offset.
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
