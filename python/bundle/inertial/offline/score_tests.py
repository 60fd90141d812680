"""Score tests of what an adjustment holds: forces, arm, axes, and biases between two images.

Let P(x) be the least cost with a number x that the adjustment holds at 0, and with all poses,
points, velocities and biases free. For residuals r that are linear in all unknowns and x,

    P(x) = P(0) + g x + h / 2 x^2,      g = j^T r,      h = j^T j,

where j is the derivative of the residuals w.r.t. x along the minimum: g is the score of x at the
present minimum (C. R. Rao, 1948), and h its information without what other unknowns explain. The
residuals of images and motions have the variance factors v and w. Random walks of biases and all
priors have 1: no factor for vibration is in their sigmas. So

    x = -g / h,      var g = v h_images + w h_motions + h_priors,      T = g^2 / var g,

with T chi2 with one degree of freedom if x = 0. g, h and its parts are the differences of P and its
parts at -D, 0 and D.

Forces that are too large by a factor f = 1 + x are those of a path and a gravity f times as large.
The length of gravity is known, and a bias along gravity has the same effect as f on an IMU
that does not tilt. A step to another scale moves weak points so far that it fails: unless something
else knows the scale, each solve begins with lengths over f.

Arm, axes and biases have three numbers each, tested along one direction, so that T is at most chi2
with three. For axes it is the turn between the rotations of images and gyroscope (axes and rates
are tested if that is half of what counts as an error), and otherwise that of g, which needs no
solve: all other derivatives are 0 at the minimum. A step s of a bias in the time T_k between two
images is an error of its random walk e_k = b_(k+1) - b_k - s, so that g = -e_k / (q^2 T_k), q the
density of the walk. The largest of n intervals is tested.

Relevance. The estimated x would move each position by a share of its distance from the mean
position. On V1_01, whose real errors are not white, T is up to 33; this share is 1.4 % by forces
and 0.3 % by others.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.tails import chi2_bound
from bundle.inertial.offline.imu_agreement import Agreement
from bundle.inertial.offline.motion_solve import ImuBodies, MotionState
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.interface.options import SolveOptions
from bundle.model.rigid_motions import quaternion_from_vector, quaternion_multiply
from bundle.model.sequence.calibration import ImuNoise
from bundle.solving.result import Result

Array = NDArray[np.float64]

HELD = {
    "accel_scale": (slice(0, 1), 0.03), "arm": (slice(1, 4), 0.05),
    "camera_from_imu": (slice(4, 7), 0.02), "gyro_bias": (slice(7, 10), 0.005),
    "accel_bias": (slice(10, 13), 0.1), "gyro_scale": (slice(13, 14), 0.02),
}  # fmt: skip
"""Place in a change, and D (m, rad, rad/s, m/s^2), over which residuals are linear, by kind."""
FALSE_ALARM = 1e-4  # probability of a false alarm in a run
LEAST_ARM = 0.02  # metres
CONFIRMED = 0.25  # share of a gain that solves with x reach, if their minima are the same
FORCES_MOVEMENT, LEAST_MOVEMENT = 0.02, 0.01  # share of the positions: smaller ones are ignored


class Change(NamedTuple):
    """Change (14,) of what an adjustment holds."""

    by: Array = np.zeros(14)
    first: int = 0  # interval from which samples lose the change of the biases

    @property
    def forces(self) -> float:
        """Divisor of the forces."""
        return 1 + float(self.by[0])

    def of_bodies(self, bodies: ImuBodies) -> ImuBodies:
        """Return the bodies with the changed body_from_imu."""
        turn = quaternion_from_vector(self.by[None, 4:7])
        axes = quaternion_multiply(bodies.body_from_imu[None, :4], turn)[0]
        changed = np.append(axes, bodies.body_from_imu[4:] + self.by[1:4])
        return dataclasses.replace(bodies, body_from_imu=changed)

    def of_samples(self, k: int, interval: ImuInterval) -> ImuInterval:
        """Return interval k with changed samples."""
        gyro, accel = self.by[7:13].reshape(2, 3) * (k >= self.first)
        rates, forces = interval.gyro / (1 + self.by[13]), interval.accel / self.forces
        return dataclasses.replace(interval, gyro=rates - gyro, accel=forces - accel)


class LeastCost(NamedTuple):
    """Minimum cost with a change, by its parts, and the positions (n, 3) at it."""

    images: float
    motions: float
    priors: float  # and random walks
    positions: Array

    @staticmethod
    def of(result: Result, state: MotionState, bodies: ImuBodies) -> LeastCost:
        """Return the cost and the positions of a result."""
        if result.summary.interrupted:
            raise KeyboardInterrupt
        costs, count = result.factor_costs_after, len(bodies) - 1
        motions, priors = float(costs[:count].sum()), float(costs[count:].sum())
        images = result.summary.final_cost - motions - priors
        return LeastCost(images, motions, priors, bodies.centers(state.problem))


class Score(NamedTuple):
    """Estimate of a number that the adjustment holds at 0."""

    kind: str  # of HELD
    along: Array = np.ones(1)  # direction of unit length
    x: float = 0.0
    sigma: float = math.inf  # its standard deviation
    chi2: float = 0.0  # T
    movement: float = 0.0  # rms movement of positions by x over their rms distance
    gain: float = 0.0  # decrease of twice the cost by x
    interval: int = 0  # interval at whose begin a bias changes
    tests: int = 1  # number of intervals

    def of(self, ends: list[LeastCost], agreement: Agreement, at: float = 0.0) -> Score:
        """Return the estimate, from the costs at -D, 0 and D; or at 0, ``at`` and 2 ``at``."""
        low, mid, high = ends
        size, costs = at or HELD[self.kind][1], np.array([end[:3] for end in ends])
        slope = float((costs[2] - costs[0]).sum()) / (2 * size)
        by_part = (costs[2] + costs[0] - 2 * costs[1]) / size**2
        curvature = float(by_part.sum())
        variances = agreement.images_variance, agreement.variance, 1.0
        spread = float(np.maximum(by_part, 0.0) @ variances)
        if not (curvature > 0 and math.isfinite(slope)):
            return self
        step = -slope / curvature
        offsets = mid.positions - mid.positions.mean(axis=0)
        moved = (high.positions - low.positions) * step / (2 * size)
        movement = float(np.linalg.norm(moved - moved.mean(axis=0)) / np.linalg.norm(offsets))
        return self._replace(
            x=at + step, sigma=math.sqrt(spread) / curvature, chi2=slope**2 / spread,
            movement=movement, gain=slope**2 / curvature,
        )  # fmt: skip

    @property
    def is_clear(self) -> bool:
        """True for an error beyond noise."""
        return self.chi2 > chi2_bound(len(self.along), FALSE_ALARM / self.tests)

    @property
    def is_relevant(self) -> bool:
        """True for an error that moves the positions, or an arm that can be measured."""
        if self.kind == "arm" and abs(self.x) > LEAST_ARM:
            return True
        least = FORCES_MOVEMENT if self.kind == "accel_scale" else LEAST_MOVEMENT
        return self.movement > least

    def change(self, x: float) -> Change:
        """Return the change by x."""
        by = np.zeros(14)
        by[HELD[self.kind][0]] = x * self.along
        return Change(by, self.interval)


def largest_score(
    least: Callable[[Change], LeastCost],
    cost: Callable[[Change], float],
    likely: list[Score],
    walks: tuple[Array, Array],
    agreement: Agreement,
) -> Score | None:
    """Return the clear estimate of the largest gain; None if no clear one is relevant.

    ``cost`` is the present one of the motions with a change, ``likely`` what other evidence shows,
    ``walks`` the derivatives (n - 1, 3) of P w.r.t. steps of both biases.
    """
    arms, size = [Score("arm", axis) for axis in np.eye(3)], HELD["arm"][1]
    slopes = np.array([cost(one.change(size)) - cost(one.change(-size)) for one in arms])
    tested = [Score("accel_scale"), Score("arm", unit(slopes)), *likely]
    for kind, slopes in zip(("gyro_bias", "accel_bias"), walks, strict=True):
        k = int(np.linalg.norm(slopes, axis=1).argmax())
        tested.append(Score(kind, unit(slopes[k]), interval=k + 1, tests=len(slopes)))
    mid, found = least(Change()), []
    for one in tested:
        low, high = (least(one.change(side * HELD[one.kind][1])) for side in (-1, 1))
        found.append(one.of([low, mid, high], agreement))
    clear = [one for one in found if one.is_clear]
    if not any(one.is_relevant for one in clear):
        return None
    for one in sorted(clear, key=lambda one: -one.gain):
        ends = [mid, *(least(one.change(share * one.x)) for share in (0.5, 1.0))]
        costs = [sum(end[:3]) for end in ends]
        if 2 * (costs[0] - min(costs)) > CONFIRMED * one.gain:
            refined = one.of(ends, agreement, one.x / 2)  # a robust loss has less curvature at 0
            return one._replace(x=refined.x, sigma=refined.sigma)
    return None


def walk_slopes(biases: Array, durations: Array, noise: ImuNoise) -> tuple[Array, Array]:
    """Return the derivatives of P w.r.t. steps of both biases between n rows (6,) of biases."""
    errors = -np.diff(biases, axis=0) / durations[:, None]
    return (
        errors[:, :3] / noise.gyro_bias_random_walk**2,
        errors[:, 3:] / noise.accel_bias_random_walk**2,
    )


def few_steps(options: SolveOptions) -> SolveOptions:
    """Return the options of a few steps to a near minimum."""
    return options.replace(
        max_num_iterations=10, initial_trust_region_radius=1e4, function_tolerance=1e-6,
        parameter_tolerance=0.0, check_solution=False,
    )  # fmt: skip


def unit(vector: Array) -> Array:
    """Return the vector with length 1."""
    found: Array = vector / max(float(np.linalg.norm(vector)), 1e-300)
    return found
