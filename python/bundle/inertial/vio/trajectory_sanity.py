"""Sanity of a path: its positions against its velocities, and the time between.

From image to image a window moves its newest position by what its velocity says, and by what it
has learned since: centimetres, some hundredths of a metre for each second of its span at speed.
What is left over, m = (p_j - p_i) - 1/2 (v_i + v_j) T, is a jump where it is more than a metre and
half a second's way; over the whole flight the m add up to a drift where they exceed two metres and
a tenth of the way.
"""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["PathSanity"]

Array = np.ndarray[Any, Any]

FASTEST = 340.0  # m/s: slower than sound
MOST_GYRO_BIAS, MOST_ACCEL_BIAS = 1.0, 5.0  # rad/s, m/s^2
JUMP, JUMP_TIME = 1.0, 0.5  # m, s
DRIFT, DRIFT_SHARE = 2.0, 0.1  # m, of the way


class PathSanity:
    """Judges one state (16,) after another.

    Args:
        stamp: of the first, ns.
        state: the first.
    """

    def __init__(self, stamp: int, state: Array) -> None:
        self._stamp, self._state = stamp, state
        self._drift, self._way = np.zeros(3), 0.0

    def objection(self, stamp: int, state: Array) -> str:
        """Return what is wrong with the next state, "" if nothing is."""
        if not np.all(np.isfinite(state)):
            return "a state is not finite"
        speeds = [float(np.linalg.norm(each[7:10])) for each in (self._state, state)]
        if speeds[1] >= FASTEST:
            return f"a speed of {speeds[1]:.3g} m/s"
        for part, most, what in (
            (slice(10, 13), MOST_GYRO_BIAS, "gyroscope bias of {:.3g} rad/s"),
            (slice(13, 16), MOST_ACCEL_BIAS, "accelerometer bias of {:.3g} m/s^2"),
        ):
            bias = float(np.linalg.norm(state[part]))
            if bias >= most:
                return f"a {what.format(bias)}"
        seconds = 1e-9 * (stamp - self._stamp)
        way = 0.5 * seconds * (self._state[7:10] + state[7:10])
        miss = state[4:7] - self._state[4:7] - way
        self._drift = self._drift + miss
        self._way += float(np.linalg.norm(way))
        self._stamp, self._state = stamp, state
        jump, drift = float(np.linalg.norm(miss)), float(np.linalg.norm(self._drift))
        if jump > JUMP + JUMP_TIME * max(speeds):
            return f"a jump of {jump:.3g} m in {seconds:.2g} s at {max(speeds):.3g} m/s"
        if drift > DRIFT + DRIFT_SHARE * self._way:
            return f"positions {drift:.3g} m off what velocities say, along {self._way:.3g} m"
        return ""
