"""IMU samples between two instants that need not be samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.errors import InputError
from bundle.vio.window_frame import ImuInterval

__all__ = ["ImuSlices"]

Array = np.ndarray[Any, Any]


class ImuSlices:
    """Cuts intervals out of a recording.

    Zero-order hold: a sample holds until the next one, so that the first piece has the sample at or
    before the interval's begin. Midpoint: samples at both ends of the interval, interpolated.

    Args:
        stamps: ns, ascending (n,).
        gyro, accel: (n, 3).
        rule: zero_order_hold or midpoint.
    """

    def __init__(self, stamps: Array, gyro: Array, accel: Array, rule: str) -> None:
        self.stamps, self.gyro, self.accel, self.rule = stamps, gyro, accel, rule

    def between(self, begin: int, end: int) -> ImuInterval:
        """Return the samples from one stamp to a later one.

        Raises:
            InputError: the recording does not cover the interval.
        """
        if not (self.stamps[0] <= begin < end <= self.stamps[-1]):
            raise InputError(
                f"IMU: expected samples from {begin} to {end} ns, found {self.stamps[0]} to "
                f"{self.stamps[-1]}"
            )
        first = int(np.searchsorted(self.stamps, begin, "right")) - 1  # at or before the begin
        last = int(np.searchsorted(self.stamps, end, "left"))  # at or after the end
        edges = self.stamps[first : last + 1].copy()
        edges[0], edges[-1] = begin, end
        dt = 1e-9 * np.diff(edges)
        if self.rule == "zero_order_hold":
            return ImuInterval(self.gyro[first:last], self.accel[first:last], dt)
        gyro, accel = self.gyro[first : last + 1].copy(), self.accel[first : last + 1].copy()
        for values, source in ((gyro, self.gyro), (accel, self.accel)):
            values[0] = self._at(source, begin, first)
            values[-1] = self._at(source, end, last - 1)
        return ImuInterval(gyro, accel, dt)

    def _at(self, values: Array, stamp: int, before: int) -> Array:
        """Interpolate between a sample and the next one."""
        a, b = self.stamps[before], self.stamps[before + 1]
        share = float(stamp - a) / float(b - a)
        between: Array = (1 - share) * values[before] + share * values[before + 1]
        return between
