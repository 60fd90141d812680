"""Detection of the unit of time stamps from the calibrated rates and the range of 64 bits.

All stamps must be nanoseconds. A sensor with rate f then has a stamp every 1e9 / f. If stamps are a
thousand or a million times closer, they are microseconds or milliseconds. Deviations from the rate
by less than half a unit, a factor of 316, are not evidence of another unit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief

_UNITS = {3: "microseconds", 6: "milliseconds", 9: "seconds"}
"""Units by the power of ten that converts them to nanoseconds."""

LATEST = 2**63 / 1e9  # s
_EARLIEST_NOW, _LATEST_NOW = 1e8, 5e9  # s since 1970 of plausible clocks


def check_stamp_unit(
    stamps: NDArray[np.int64], rate: float, name: str, place: Callable[[int], str]
) -> None:
    """Raise an error for stamps that are not nanoseconds.

    Args:
        stamps: (n,) stamps, not necessarily sorted; repeated stamps count once.
        rate: rate of the sensor [Hz].
        name: name of the rate in the calibration.
        place: function that converts a row to text for messages.

    Raises:
        InputError: the stamps are far too close to each other for the rate.
    """
    times = np.unique(stamps)
    if len(times) < 2:
        return
    period = float(np.median(np.diff(times)))
    power = math.log10(1e9 / (rate * period))
    if power > 2.5:
        unit = _UNITS[min(max(3 * round(power / 3), 3), 9)]
        raise InputError(
            f"{place(0)}: expected stamps in nanoseconds, {1e9 / rate:.3g} apart for the {name} of "
            f"{rate:g} Hz, found {period:.3g} apart; are they in {unit}?"
        )


def stamp_of_seconds(word: str, place: str) -> int:
    """Convert a stamp in seconds to nanoseconds without rounding.

    Raises:
        InputError: the stamp is not finite, or its nanoseconds exceed 64 bits.
    """
    seconds = Decimal(word)
    if seconds.is_finite() and abs(seconds) <= LATEST:
        stamp = int(seconds.scaleb(9))
        if abs(stamp) < 2**63:
            return stamp
    hint = ""
    if seconds.is_finite():
        for power, unit in ((3, "milliseconds"), (6, "microseconds"), (9, "nanoseconds")):
            if _EARLIEST_NOW < abs(seconds).scaleb(-power) < _LATEST_NOW:
                hint = f": {unit}?"
    raise InputError(f"{place}: timestamp: expected seconds, found {brief(word)[1:-1]}{hint}")


def other_unit(stamps: NDArray[np.int64], others: NDArray[np.int64]) -> str:
    """Return a hint if stamps, times a power of 1000, fall into the range of others; else ""."""
    first, last = float(others.min()), float(others.max())
    for power in (-9, -6, -3, 3, 6, 9):
        scaled = stamps * 10.0**power
        if ((scaled >= first) & (scaled <= last)).sum() > 1:
            return (
                f": stamps in another unit? {10.0**power:g} times as large they would be among them"
            )
    return ""
