"""States ahead of the last one that is known, from IMU samples alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle import _core
from bundle.base.arguments import as_array
from bundle.inertial.preintegration.preintegration import RULES, as_vector
from bundle.interface.option_fields import choice

__all__ = ["propagate"]


def propagate(
    state: ArrayLike,
    gyro: ArrayLike,
    accel: ArrayLike,
    dt: ArrayLike,
    *,
    gravity: ArrayLike = (0.0, 0.0, -9.81),
    rule: str = "zero_order_hold",
) -> NDArray[np.float64]:
    """Return the states after each of n intervals, (n, 16).

    A state is qx qy qz qw of world_from_imu, position (m) and velocity (m/s) in the world, the
    gyroscope's bias (rad/s) and the accelerometer's (m/s^2), which stay.

    Args:
        state: (16,) at the first sample.
        gyro: (n, 3) rad/s; by midpoint (n + 1, 3), a sample at each end of an interval.
        accel: m/s^2, specific force, likewise.
        dt: (n,) seconds, each above 0.
        gravity: (3,) m/s^2 in the world.
        rule: as of :class:`bundle.Preintegration`.

    Raises:
        InputError: shapes do not fit, numbers are not finite, or a time is not above 0.
    """
    return _core.propagate(
        as_vector("state", state, 16),
        as_vector("gravity", gravity),
        choice("rule", rule, RULES),
        as_array("gyro", gyro),
        as_array("accel", accel),
        as_array("dt", dt),
    )
