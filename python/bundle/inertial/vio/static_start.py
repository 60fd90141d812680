"""Start at rest: gravity from the accelerometer, gyroscope bias from the mean rate.

At rest the specific force is -g in the IMU frame, so its mean f gives the tilt: the shortest
rotation that takes f to the world's z axis; yaw is arbitrary. The difference of |f| and |g| is the
accelerometer bias along gravity, which the window estimates.

A vehicle counts as at rest while its tracks stay at their first positions, up to noise, and the
mean rate does not change. IMU samples alone are not sufficient. Rotors that spin on the ground
shake an accelerometer more than slow flight does.

Two positions of a track, each with noise s in both coordinates, have a median distance of 1.7 s.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bundle.inertial.vio.sequence_images import SequenceImages

REST_SIGMAS = 3.0  # median displacement of the tracks; noise alone gives 1.7
FEWEST_TRACKS = 4
REST_RATE = 0.03  # rad/s: change of the mean rate
REST_WINDOW = 0.5  # s, for that mean


def rest_at_start(images: SequenceImages) -> tuple[int, int]:
    """Return the last image at rest and the number of samples at rest at the start.

    If the sequence begins in motion, these are the first covered image and 0.
    """
    sequence = images.sequence
    first = int(np.argmax(images.covered))
    last = _last_still_image(images, first)
    stamps, gyro = sequence.imu_timestamps_ns, sequence.gyro
    end = int(images.stamps[last])
    samples = int(np.searchsorted(stamps, end, side="right")) if last > first else 0
    size = int(np.searchsorted(stamps, stamps[0] + round(1e9 * REST_WINDOW)))
    if samples < size or size < 2:
        return first, 0
    means = gyro[: samples // size * size].reshape(-1, size, 3).mean(axis=1)
    turned = np.flatnonzero(np.abs(means - means[0]).max(axis=1) > REST_RATE)
    if len(turned):
        samples = int(turned[0]) * size
        still = np.flatnonzero(images.stamps <= stamps[samples - 1])
        last = max(first, int(still[-1])) if len(still) else first
    return last, samples


def _last_still_image(images: SequenceImages, first: int) -> int:
    calibration = images.sequence.calibration
    rows = slice(int(images.begin[first]), None)
    xy: Any = calibration.focal * images.xy[rows]
    _, seen, track = np.unique(images.ids[rows], return_index=True, return_inverse=True)
    moved = np.linalg.norm(xy - xy[seen[track]], axis=1)
    is_seen_again = seen[track] != np.arange(len(xy))
    begin = images.begin - images.begin[first]
    last = first
    for image in range(first + 1, len(images)):
        rows = slice(begin[image], begin[image + 1])
        again = is_seen_again[rows]
        if not images.covered[image] or again.sum() < FEWEST_TRACKS:
            break
        if np.median(moved[rows][again]) > REST_SIGMAS * calibration.pixel_sigma:
            break
        last = image
    return last


Array = np.ndarray[Any, Any]

LONGEST = 10.0  # s, longest time at rest that is used
SHORTEST = 0.5
GYRO_SCATTER = 0.06  # rad/s: motors shake, but the platform does not turn
ACCEL_SCATTER = 0.8  # m/s^2


class StaticStart(NamedTuple):
    """State (16,) at rest at its origin, and the first and last image at rest."""

    state: Array
    first_image: int
    last_image: int


def find_static_start(images: SequenceImages, gravity: float = 9.81) -> StaticStart | None:
    """Return the rest at the start of a sequence, or None if it begins in motion.

    Rest is defined as in :func:`rest_at_start` and must last at least half a second. Standard
    deviations must be at most 0.06 rad/s (gyroscope) and 0.8 m/s^2 (accelerometer). The mean force
    must be within 1 m/s^2 of gravity.
    """
    sequence, stamps = images.sequence, images.stamps
    first = int(np.argmax(images.covered))
    last, _ = rest_at_start(images)
    limit = stamps[first] + round(1e9 * LONGEST)
    last = min(last, int(np.searchsorted(stamps, limit, "right")) - 1)
    # Tracks show motion slightly later than the platform moves.
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
