"""A start at rest: gravity from the accelerometer, the gyroscope's bias from its mean.

At rest the specific force is -g in the IMU's frame, so its mean f gives the tilt: the shortest
rotation that takes f to the world's z axis; yaw stays as it is. What |f| differs from |g| by is the
accelerometer's bias along gravity, and is left to the window.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bundle.inertial.vio.rest_at_start import rest_at_start
from bundle.inertial.vio.sequence_images import SequenceImages

__all__ = ["StaticStart", "find_static_start", "level_quaternion"]

Array = np.ndarray[Any, Any]

LONGEST = 10.0  # s, of the time at rest that is looked at
SHORTEST = 0.5
GYRO_SCATTER = 0.06  # rad/s: motors shake, but nothing turns
ACCEL_SCATTER = 0.8  # m/s^2


class StaticStart(NamedTuple):
    """A state (16,) at rest at its origin, and the first and last image at rest."""

    state: Array
    first_image: int
    last_image: int


def find_static_start(images: SequenceImages, gravity: float = 9.81) -> StaticStart | None:
    """Return the rest at the begin of a sequence, or None if it begins in motion.

    At rest as :func:`rest_at_start` finds it, for half a second at least, the gyroscope within 0.06
    rad/s and the accelerometer within 0.8 m/s^2 (standard deviations), and its mean within 1 m/s^2
    of gravity.
    """
    sequence, stamps = images.sequence, images.stamps
    first = int(np.argmax(images.covered))
    last, _ = rest_at_start(images)
    limit = stamps[first] + round(1e9 * LONGEST)
    last = min(last, int(np.searchsorted(stamps, limit, "right")) - 1)
    # Tracks begin to move a little after the platform does.
    until = stamps[first] + int(0.8 * (stamps[last] - stamps[first]))
    last = int(np.searchsorted(stamps, until, "right")) - 1
    if stamps[last] - stamps[first] < 1e9 * SHORTEST:
        return None
    t = sequence.imu_timestamps_ns
    rest = slice(int(np.searchsorted(t, stamps[first])), int(np.searchsorted(t, stamps[last])))
    gyro, accel = sequence.gyro[rest], sequence.accel[rest]
    mean = accel.mean(axis=0)
    if (
        np.linalg.norm(gyro.std(axis=0)) > GYRO_SCATTER
        or np.linalg.norm(accel.std(axis=0)) > ACCEL_SCATTER
        or abs(np.linalg.norm(mean) - gravity) > 1.0
    ):
        return None
    state = np.zeros(16)
    state[:4] = level_quaternion(mean)
    state[10:13] = gyro.mean(axis=0)
    return StaticStart(state, first, last)


def level_quaternion(force: Array) -> Array:
    """Return the quaternion x y z w of the shortest rotation that takes a force to the z axis."""
    up = force / np.linalg.norm(force)
    w = 1.0 + up[2]
    if w < 1e-9:  # upside down: half a turn about x
        return np.array([1.0, 0.0, 0.0, 0.0])
    quaternion = np.array([up[1], -up[0], 0.0, w])  # up x z, 1 + up . z
    level: Array = quaternion / np.linalg.norm(quaternion)
    return level
