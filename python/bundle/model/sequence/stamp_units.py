"""Units of time stamps, detected by the rates of a calibration and the range of 64 bits.

All stamps are nanoseconds. A sensor with rate f has a stamp every 1e9 / f; if stamps are a thousand
or a million times closer, they are microseconds or milliseconds. Rates that are off by less than
half a unit, a factor of 316, give no information on the unit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError, brief

__all__ = ["LATEST", "check_stamp_unit", "other_unit", "stamp_of_seconds"]

_UNITS = {3: "microseconds", 6: "milliseconds", 9: "seconds"}
"""By the power of ten that nanoseconds have more of."""

LATEST = 2**63 / 1e9  # s
_EARLIEST_NOW, _LATEST_NOW = 1e8, 5e9  # s since 1970 of plausible clocks


def check_stamp_unit(
    stamps: NDArray[np.int64], rate: float, name: str, place: Callable[[int], str]
) -> None:
    """Refuse stamps that are not nanoseconds.

    Args:
        stamps: (n,), not necessarily sorted; those that repeat count once.
        rate: of the sensor [Hz].
        name: of the rate in the calibration.
        place: function that names a row.

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
            f"{place(0)}: expected stamps in nanoseconds, one every {1e9 / rate:.3g} as the "
            f"{name} of {rate:g} Hz says, found one every {period:.3g}: {unit}?"
        )


def stamp_of_seconds(word: str, place: str) -> int:
    """Convert a stamp in seconds to nanoseconds without rounding.

    Raises:
        InputError: it is not finite, or its nanoseconds exceed 64 bits.
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
    """Return a hint if stamps times a power of a thousand fall into the range of others, or ""."""
    first, last = float(others.min()), float(others.max())
    for power in (-9, -6, -3, 3, 6, 9):
        scaled = stamps * 10.0**power
        if ((scaled >= first) & (scaled <= last)).sum() > 1:
            return (
                f": stamps in another unit? {10.0**power:g} times as large they would be among them"
            )
    return ""
