"""Whether a new gyroscope bias is too far for a first-order correction of preintegrated samples.

Turning at a constant rate through an angle Theta in the time T, with a change d of the bias across
the axis, the rotation corrected to first order is off by

    e = (Theta - sin Theta) / (2 Theta^2) (|d| T)^2,

about w |d|^2 T^3 / 12 for a rate w, and at most (|d| T)^2 / (2 pi), at Theta = pi. It is an error
of the second order: ten times the change, a hundred times the error. A change along the axis has
none. A rotation error e tilts gravity and leaks |g| e into the acceleration, which does no harm
below what the accelerometer's own bias leaves open: e < b / |g|. Where the motion turns by more
than pi, or to and fro, Theta = pi is taken: the least favourable angle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from bundle.base.display import Display, Displayed

__all__ = ["Repropagation", "first_order_error"]

GRAVITY = 9.81  # m/s^2


def first_order_error(angle: float, bias_change: float, duration: float) -> float:
    """Return by how much the first-order correction is off, in radians.

    Args:
        angle: Theta, in radians, at least 0.
        bias_change: |d| across the axis, in rad/s.
        duration: T, in seconds.
    """
    square = angle * angle
    if angle < 0.1:  # (Theta - sin Theta) / Theta^2 by its series: the difference loses digits
        coefficient = angle / 12 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72)))
    else:
        coefficient = (angle - math.sin(angle)) / (2 * square)
    return coefficient * (bias_change * duration) ** 2


@dataclass(frozen=True, repr=False)
class Repropagation(Displayed):
    """Whether samples should be integrated again, true or false as a condition, and why.

    Attributes:
        needed: whether ``tilt`` exceeds ``limit``.
        tilt: error of the first-order correction, in radians.
        limit: tilt that leaks as much as the accelerometer's bias, in radians.
        bias_change: |new gyroscope bias - that of the integration|, in rad/s.
        duration: of the samples, in seconds.
        turned: angle that was turned through, in radians, summed over all samples.
    """

    needed: bool
    tilt: float
    limit: float
    bias_change: float
    duration: float
    turned: float

    @staticmethod
    def of(bias_change: float, duration: float, turned: float, accel_bias: float) -> Repropagation:
        """Return the verdict for a change of the bias and an accelerometer bias left open."""
        tilt = first_order_error(min(turned, math.pi), bias_change, duration)
        limit = accel_bias / GRAVITY
        return Repropagation(tilt > limit, tilt, limit, bias_change, duration, turned)

    def __bool__(self) -> bool:
        return self.needed

    @property
    def reason(self) -> str:
        """One sentence with the numbers."""
        leak = self.tilt * GRAVITY
        return (
            f"a bias change of {self.bias_change:.3g} rad/s over {self.duration:.3g} s tilts the "
            f"first-order correction by {self.tilt:.3g} rad, which leaks {leak:.3g} m/s^2 of "
            f"gravity: {'above' if self.needed else 'within'} the accelerometer bias of "
            f"{self.limit * GRAVITY:.3g} m/s^2"
        )

    def _display(self) -> Display:
        return Display(
            title=f"Repropagation: {'needed' if self.needed else 'not needed'}",
            facts=(
                ("tilt", f"{self.tilt:.3g} rad, limit {self.limit:.3g}"),
                ("bias change", f"{self.bias_change:.3g} rad/s"),
                ("duration", f"{self.duration:.3g} s"),
                ("turned", f"{math.degrees(self.turned):.1f} degrees"),
            ),
        )
