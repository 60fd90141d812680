"""A seeded flight in circles, as an IMU at 200 Hz, a window that drifts, and closures see it."""

from __future__ import annotations

import numpy as np

import bundle
from bundle.inertial.two_loops.pose_publisher import YawMotion

RATE = 200
PERIOD_NS = 5_000_000
GRAVITY = np.array([0, 0, -9.81])
KEYFRAME_EVERY = 20  # samples


class Flight:
    """`count` samples of a circle, with a wobble; `states` (count + 1, 16) are exact for them."""

    def __init__(self, count: int, seed: int = 0, radius: float = 5.0, turn: float = 0.8) -> None:
        rng = np.random.default_rng(seed)
        t = np.arange(count) / RATE
        self.gyro = np.c_[0.05 * np.sin(3 * t), 0.05 * np.cos(2 * t), np.full(count, turn)]
        self.gyro += 0.01 * rng.standard_normal((count, 3))
        self.accel = np.c_[
            0.2 * np.sin(1.7 * t) - radius * turn**2, np.zeros(count), 9.81 + 0.3 * np.cos(t)
        ]
        self.stamps = 1_000_000_000 + PERIOD_NS * np.arange(count + 1)
        start = np.r_[0, 0, 0, 1, radius, 0, 1, 0, radius * turn, 0, np.zeros(6)]
        steps = np.full(count, 1 / RATE)
        states = bundle.propagate(start, self.gyro, self.accel, steps)
        self.states = np.vstack([start, states])

    def publisher(self, **settings) -> bundle.PosePublisher:
        return bundle.PosePublisher(self.stamps[0], self.states[0], **settings)

    def publish(self, publisher: bundle.PosePublisher, k: int):
        """Sample k, which holds from its stamp on."""
        return publisher.publish(self.stamps[k], self.gyro[k], self.accel[k])


def drifted(states: np.ndarray, yaw: float, shift: np.ndarray) -> np.ndarray:
    """States of a window whose world turns and shifts by this from the first to the last."""
    out = []
    for share, state in zip(np.linspace(0, 1, len(states)), states, strict=True):
        out.append(YawMotion(share * yaw, share * shift).moved(state))
    return np.array(out)
