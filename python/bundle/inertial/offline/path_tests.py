"""Tests by the path of the images: the arm of camera_from_imu, the scale of the forces."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.tails import chi2_bound
from bundle.inertial.offline.inertial_start import segment_rows, segments
from bundle.inertial.offline.motion_solve import ACCEL_BIAS_SIGMA
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.interface.options import SolveOptions
from bundle.model.sequence.calibration import ImuNoise

# Error of the arm of camera_from_imu, by the path of images alone.
#
# The equations of ``inertial_start`` are linear in an error d of the arm, along the axes of the
# body: with R_k = world_from_body,
#
#     s c_k + l_k + R_k d = p_0 + v_0 t + 1/2 g t^2 + P_k + Q_k a.
#
# The length of g is free: a scale of the forces has no influence. The errors are those of
# positions, white with sigma p, and those of samples: the integrals of a white noise n and of a
# random walk w of the bias. For t <= u, an axis has the covariance
#
#     p^2 [t = u] + n^2 (t^2 u / 2 - t^3 / 6) + w^2 (t^3 u^2 / 12 - t^4 u / 24 + t^5 / 120),
#
# by which each segment is whitened. The residuals give the factor v of all covariances, at least 1.
# p is small on purpose: larger errors of positions then count by v, as if they were slow. The prior
# of the bias does not depend on v. d^T C^-1 d is chi2 with 3 degrees of freedom, C its covariance.

Array = NDArray[np.float64]

POSITION_SIGMA = 1e-3  # metres: p
ARM_SIGMA = 1.0  # metres: a weak prior on d, for paths that do not turn
FALSE_ALARM = 1e-4  # probability of a false alarm in a run
DISPERSION = 2.0  # mean chi2 of right arms over its expectation in 30 flights: errors correlate
LEAST = 0.02  # metres: smaller errors are ignored


class ArmError(NamedTuple):
    """Error of the arm."""

    shift: Array = np.zeros(3)  # (3,) d in metres: the right arm is the given one plus d
    covariance: Array = np.eye(3)  # (3, 3)

    @property
    def chi2(self) -> float:
        """Squared error in sigmas, 3 degrees of freedom."""
        return float(self.shift @ np.linalg.solve(self.covariance, self.shift))

    @property
    def size(self) -> tuple[float, float]:
        """Length of d in metres, and its standard deviation."""
        length = float(np.linalg.norm(self.shift))
        along = self.shift / max(length, 1e-12)
        return length, float(np.sqrt(along @ self.covariance @ along))

    @property
    def is_wrong(self) -> bool:
        """True for an error beyond noise."""
        return self.size[0] > LEAST and self.chi2 > DISPERSION * chi2_bound(3, FALSE_ALARM)


def arm_error(
    rotations: Array,
    centers: Array,
    arms: Array,
    axes: Array,
    motions: list[Preintegration],
    noise: ImuNoise,
) -> ArmError:
    """Return the error; arguments as in ``inertial_start``, then world_from_body (n, 3, 3)."""
    times = np.cumsum([0.0, *(motion.duration for motion in motions)])
    rows, freedom = [], -10
    for part in segments(times):
        given = segment_rows(part, rotations, centers, arms, motions, times)
        n = len(part)
        turned = axes[part[0] : part[-1] + 1].reshape(-1, 3)
        root = np.linalg.inv(np.linalg.cholesky(_covariance(times[part] - times[part[0]], noise)))
        columns = np.column_stack([given.own, given.shared, turned, given.known])
        whitened = (root @ columns.reshape(n, -1)).reshape(3 * n, -1)
        basis = np.linalg.qr(whitened[:, :6])[0]
        rows.append(whitened[:, 6:] - basis @ (basis.T @ whitened[:, 6:]))
        freedom += 3 * n - 6
    if freedom < 1:
        return ArmError()
    system, factor = np.vstack(rows), 1.0
    for _ in range(2):
        prior = math.sqrt(factor) * np.eye(6, 11, 4)
        prior[:3] /= ACCEL_BIAS_SIGMA
        prior[3:] /= ARM_SIGMA
        columns = np.vstack([system, prior])
        x: Any = np.linalg.lstsq(columns[:, :10], columns[:, 10], rcond=None)[0]
        residual = system[:, 10] - system[:, :10] @ x
        factor = max(float(residual @ residual) / freedom, 1.0)
    inverse: Any = factor * np.linalg.pinv(columns[:, :10].T @ columns[:, :10])
    return ArmError(x[7:], inverse[7:, 7:])


def _covariance(times: Array, noise: ImuNoise) -> Array:
    """Return the covariance of the errors of one axis at n times since the first."""
    t, u = np.minimum.outer(times, times), np.maximum.outer(times, times)
    white = noise.accel_noise_density**2 * (t**2 * u / 2 - t**3 / 6)
    walk = noise.accel_bias_random_walk**2 * (t**3 * u**2 / 12 - t**4 * u / 24 + t**5 / 120)
    found: Array = POSITION_SIGMA**2 * np.eye(len(times)) + white + walk
    return found


# Scale of the forces of an accelerometer, from the cost of an adjustment as a function of this
# scale.
#
# Forces that are f times too large are those of a path and a gravity that are f times as large. The
# length of gravity is known, and a bias along gravity has the same effect as f on an IMU that does
# not tilt. So f is tested with all poses, points, velocities and biases free: let P(f) be the least
# cost with forces divided by f. For residuals r that are linear in all unknowns and f,
#
#     P(f) = P(1) + g (f - 1) + h / 2 (f - 1)^2,      g = j^T r,      h = j^T j,
#
# where j is the derivative of the residuals w.r.t. f along the minimum: g is the score of f at the
# present minimum (C. R. Rao, 1948), and h its information without what other unknowns explain. The
# residuals of images and motions have the variance factors v and w. Random walks of biases and all
# priors have 1: no factor for vibration is in their sigmas. So
#
#     f = 1 - g / h,      var g = v h_images + w h_motions + h_priors,      T = g^2 / var g,
#
# with T chi2 with one degree of freedom if f = 1. g, h and its parts are the differences of P and
# its parts at 1 - D, 1 and 1 + D. A step to another scale moves weak points so far that it fails:
# unless something else knows the scale, each solve begins with lengths over f.
#
# Relevance. The estimated f would move each position by a share of its distance from the mean
# position. On V1_01, whose real errors are not white, T is 25 and this share 1.6 %.


STEP = 0.03  # D: the smallest error of interest, over which the residuals are linear
LEAST_MOVEMENT = 0.02  # share of the positions: smaller movements are ignored


class LeastCost(NamedTuple):
    """Minimum cost, by its parts, at a scale of the forces, and the positions (n, 3) at it."""

    images: float
    motions: float
    priors: float  # and random walks
    positions: Array


class ForceScale(NamedTuple):
    """Scale of the forces."""

    ratio: float = 1.0  # f
    sigma: float = math.inf  # its standard deviation
    movement: float = 0.0  # rms movement of positions by f over their rms distance
    gain: float = 0.0  # decrease of twice the cost by f

    @staticmethod
    def of(
        least: Callable[[float], LeastCost], images_variance: float, variance: float
    ) -> ForceScale:
        """Return the scale; ``least`` is a function of f."""
        low, mid, high = (least(f) for f in (1 - STEP, 1.0, 1 + STEP))
        costs = np.array([end[:3] for end in (low, mid, high)])
        slope = float((costs[2] - costs[0]).sum()) / (2 * STEP)
        by_part = (costs[2] + costs[0] - 2 * costs[1]) / STEP**2
        curvature = float(by_part.sum())
        spread = float(np.maximum(by_part, 0.0) @ [images_variance, variance, 1.0])
        if not (curvature > 0 and math.isfinite(slope)):
            return ForceScale()
        error = -slope / curvature
        offsets = mid.positions - mid.positions.mean(axis=0)
        moved = (high.positions - low.positions) * error / (2 * STEP)
        movement = float(np.linalg.norm(moved - moved.mean(axis=0)) / np.linalg.norm(offsets))
        gain = slope**2 / curvature
        return ForceScale(1 + error, math.sqrt(spread) / curvature, movement, gain)

    @property
    def is_wrong(self) -> bool:
        """True for a scale beyond noise that moves the positions."""
        squared = ((self.ratio - 1) / self.sigma) ** 2
        return self.movement > LEAST_MOVEMENT and squared > chi2_bound(1, FALSE_ALARM)


def few_steps(options: SolveOptions) -> SolveOptions:
    """Return the options of a few steps to a near minimum."""
    return options.replace(
        max_num_iterations=10,
        initial_trust_region_radius=1e4,
        function_tolerance=1e-6,
        parameter_tolerance=0.0,
        check_solution=False,
    )
