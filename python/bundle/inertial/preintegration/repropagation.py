"""Decision to repropagate samples when a new gyroscope bias is too far for first order.

For a rotation at a constant rate through an angle Theta in the time T, and a bias change d
perpendicular to the axis, the error of the first-order correction is

    e = (Theta - sin Theta) / (2 Theta^2) (|d| T)^2,

about w |d|^2 T^3 / 12 for a rate w, and at most (|d| T)^2 / (2 pi), at Theta = pi. The error is of
second order: a change ten times as large gives an error a hundred times as large. A change along
the axis causes no error. A rotation error e tilts gravity and leaks |g| e into the acceleration. It
is harmless below the uncertainty b of the accelerometer bias: e < b / |g|. If the motion rotates by
more than pi, or back and forth, the worst angle is assumed, Theta = pi.
"""

from __future__ import annotations

import math

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass

GRAVITY = 9.81  # m/s^2


def first_order_error(angle: float, bias_change: float, duration: float) -> float:
    """Return the error of the first-order correction in radians.

    Args:
        angle: Theta, in radians, at least 0.
        bias_change: |d| perpendicular to the axis, in rad/s.
        duration: T, in seconds.
    """
    square = angle * angle
    if angle < 0.1:  # series of (Theta - sin Theta) / Theta^2: the difference loses digits
        coefficient = angle / 12 * (1 - square / 20 * (1 - square / 42 * (1 - square / 72)))
    else:
        coefficient = (angle - math.sin(angle)) / (2 * square)
    return coefficient * (bias_change * duration) ** 2


@dataclass(frozen=True, repr=False)
class Repropagation(Displayed):
    """Decision to integrate samples again, true or false as a condition, with its reason.

    Attributes:
        needed: True if ``tilt`` exceeds ``limit``.
        tilt: error of the first-order correction, in radians.
        limit: tilt that leaks as much as the accelerometer bias, in radians.
        bias_change: |new gyroscope bias - that of the integration|, in rad/s.
        duration: duration of the samples, in seconds.
        turned: accumulated rotation angle of all samples, in radians.
    """

    needed: bool
    tilt: float
    limit: float
    bias_change: float
    duration: float
    turned: float

    @staticmethod
    def of(bias_change: float, duration: float, turned: float, accel_bias: float) -> Repropagation:
        """Return the decision for a bias change and an uncertainty of the accelerometer bias."""
        tilt = first_order_error(min(turned, math.pi), bias_change, duration)
        limit = accel_bias / GRAVITY
        return Repropagation(tilt > limit, tilt, limit, bias_change, duration, turned)

    def __bool__(self) -> bool:
        return self.needed

    @property
    def reason(self) -> str:
        """Reason with the numbers, in one sentence."""
        leak = self.tilt * GRAVITY
        return (
            f"a bias change of {self.bias_change:.3g} rad/s over {self.duration:.3g} s "
            f"tilts the first-order correction by {self.tilt:.3g} rad, which leaks "
            f"{leak:.3g} m/s^2 of gravity: {'above' if self.needed else 'within'} the "
            f"accelerometer bias of {self.limit * GRAVITY:.3g} m/s^2"
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
