r"""Scale of the forces of an accelerometer, by the cost of an adjustment as a function of it.

Forces that are f times too large are those of a path and a gravity that are f times as large. The
length of gravity is known, and a bias along gravity has the same effect as f on an IMU that does
not tilt. So f is tested with all poses, points, velocities and biases free: let P(f) be the least
cost with forces divided by f. For residuals r that are linear in all unknowns and f,

    P(f) = P(1) + g (f - 1) + h / 2 (f - 1)^2,      g = j^T r,      h = j^T j,

where j is the derivative of the residuals by f along the minimum: g is the score of f at the
present minimum (C. R. Rao, 1948), and h its information without what other unknowns explain. The
residuals of images and those of the IMU have the variance factors v and w, so that

    f = 1 - g / h,      var g = v h_images + w h_imu,      T = g^2 / var g,

with T chi2 with one degree of freedom if f = 1. g, h and its two parts are the differences of P and
its parts at 1 - D, 1 and 1 + D. Each is the end of the same few Gauss-Newton steps from the present
minimum: what is left to its own minimum is then the same in all three, and cancels.

Relevance. The estimated f would move the positions, without their mean, by a share of their
distances from it. On V1_01, whose real errors are not white, T is 25 and this share 1.4 %.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.graphs.pose_graphs.chi2_quantiles import chi2_bound
from bundle.interface.options import SolveOptions

Array = NDArray[np.float64]

STEP = 0.03
"""D: the smallest error of interest, over which the residuals are linear."""
FALSE_ALARM = 1e-4
"""Probability of a false alarm in a run."""
LEAST_MOVEMENT = 0.02
"""Share of the positions: smaller movements do not count."""


class LeastCost(NamedTuple):
    """Least costs of images and IMU for a scale of the forces, and positions (n, 3) there."""

    images: float
    imu: float
    positions: Array


class ForceScale(NamedTuple):
    """Scale of the forces.

    Attributes:
        ratio: f.
        sigma: its standard deviation.
        movement: rms movement of the positions by f over their rms distance from their mean.
    """

    ratio: float = 1.0
    sigma: float = math.inf
    movement: float = 0.0

    @staticmethod
    def of(
        least: Callable[[float], LeastCost], images_variance: float, variance: float
    ) -> ForceScale:
        """Return the scale.

        Args:
            least: function of f.
            images_variance: variance factor of the images.
            variance: that of the IMU.
        """
        low, mid, high = (least(f) for f in (1 - STEP, 1.0, 1 + STEP))
        by_images, by_imu = (
            (getattr(high, part) + getattr(low, part) - 2 * getattr(mid, part)) / STEP**2
            for part in ("images", "imu")
        )
        slope = (high.images + high.imu - low.images - low.imu) / (2 * STEP)
        curvature = by_images + by_imu
        spread = images_variance * max(by_images, 0.0) + variance * max(by_imu, 0.0)
        if not (curvature > 0 and math.isfinite(slope)):
            return ForceScale()
        error = -slope / curvature
        offsets = mid.positions - mid.positions.mean(axis=0)
        moved = (high.positions - low.positions) * error / (2 * STEP)
        movement = float(np.linalg.norm(moved - moved.mean(axis=0)) / np.linalg.norm(offsets))
        return ForceScale(1 + error, math.sqrt(spread) / curvature, movement)

    @property
    def is_wrong(self) -> bool:
        """True for a scale beyond noise that moves the positions."""
        squared = ((self.ratio - 1) / self.sigma) ** 2
        return self.movement > LEAST_MOVEMENT and squared > chi2_bound(1, FALSE_ALARM)


def few_steps(options: SolveOptions) -> SolveOptions:
    """Return the options of a few Gauss-Newton steps."""
    return options.replace(
        max_num_iterations=3,
        initial_trust_region_radius=1e8,
        function_tolerance=1e-12,
        parameter_tolerance=0.0,
        check_solution=False,
    )
