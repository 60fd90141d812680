"""A start at rest: gravity from the accelerometer, the gyroscope's bias from its mean.

At rest the specific force is -g in the IMU's frame, so its mean f gives the tilt: the shortest
rotation that takes f to the world's z axis; yaw stays as it is. What |f| differs from |g| by is the
accelerometer's bias along gravity, and is left to the window.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bundle.vio.sequence import Sequence

__all__ = ["StaticStart", "find_static_start", "level_quaternion"]

Array = np.ndarray[Any, Any]

LONGEST = 10.0  # s, of the time at rest that is looked at
SHORTEST = 0.5
PIXELS = 2.0  # of a track since the start, at most, its median over all tracks
GYRO_SCATTER = 0.06  # rad/s: motors shake, but nothing turns
ACCEL_SCATTER = 0.8  # m/s^2


class StaticStart(NamedTuple):
    """A state (16,) at rest at its origin, and the first and last image at rest."""

    state: Array
    first_image: int
    last_image: int


def find_static_start(sequence: Sequence, gravity: float = 9.81) -> StaticStart | None:
    """Return the rest at the begin of a sequence, or None if it begins in motion.

    At rest means for half a second at least: tracks stay within 2 pixels, the gyroscope within 0.06
    rad/s and the accelerometer within 0.8 m/s^2 (standard deviations), and its mean within 1 m/s^2
    of gravity.
    """
    stamps, begin = sequence.frames()
    images = sequence.image_timestamps_ns[begin[:-1]]
    inside = (images >= sequence.imu_timestamps_ns[0]) & (images <= sequence.imu_timestamps_ns[-1])
    first = int(np.argmax(inside))
    xy, ids = sequence.normalized(), sequence.track_ids
    focal = sequence.calibration.focal
    rows = slice(begin[first], begin[first + 1])
    start_ids, start_xy = ids[rows], xy[rows]
    last = first
    for image in range(first + 1, len(stamps)):
        if images[image] - images[first] > 1e9 * LONGEST or not inside[image]:
            break
        rows = slice(begin[image], begin[image + 1])
        _, a, b = np.intersect1d(start_ids, ids[rows], assume_unique=True, return_indices=True)
        if len(a) < 4:
            break
        moved = focal * np.median(np.linalg.norm(xy[rows][b] - start_xy[a], axis=1))
        if moved > PIXELS:
            break
        last = image
    # Tracks begin to move a little after the platform does.
    until = images[first] + int(0.8 * (images[last] - images[first]))
    last = int(np.searchsorted(images, until, "right")) - 1
    if images[last] - images[first] < 1e9 * SHORTEST:
        return None
    t = sequence.imu_timestamps_ns
    rest = slice(int(np.searchsorted(t, images[first])), int(np.searchsorted(t, images[last])))
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
