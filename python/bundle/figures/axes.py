"""Axes of figures: ranges and ticks."""

from __future__ import annotations

import math
from collections.abc import Iterable

from bundle.base.records import dataclass

MOST_TICKS = 6
LARGEST = 308
"""Exponent of the largest power of ten that a double can hold."""

SHAPE = 410 / 266
"""Ratio of width to height of a chart: (480 - 58 - 12) / (320 - 10 - 44) on a page."""


@dataclass(frozen=True)
class Axis:
    """Axis from ``low`` to ``high`` with its ticks; positions go from 0 to 1."""

    low: float
    high: float
    ticks: tuple[float, ...]
    is_logarithmic: bool = False
    label: str = ""

    def __call__(self, value: float) -> float:
        """Return the position of a value, 0 at ``low`` and 1 at ``high``, limited to 0 to 1."""
        if self.is_logarithmic:
            value, low, high = (math.log(max(x, 1e-300)) for x in (value, self.low, self.high))
        else:  # halve both: the difference of large numbers would overflow
            value, low, high = value / 2, self.low / 2, self.high / 2
        return min(max((value - low) / (high - low), 0.0), 1.0)


def linear(values: Iterable[float], label: str = "", *, low: float | None = 0.0) -> Axis:
    """Return an axis over the finite values with round ticks; ``low`` None: from the smallest."""
    finite = [value for value in values if math.isfinite(value)]
    start = min(finite, default=0.0) if low is None else low
    end = max([*finite, start])
    rough = end / (MOST_TICKS - 1) - start / (MOST_TICKS - 1)
    if rough <= max(1e-300, 1e-14 * abs(start)):  # equal up to rounding errors
        end = start + max(1.0, 1e-9 * abs(start))
        rough = end / (MOST_TICKS - 1) - start / (MOST_TICKS - 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next((power * factor for factor in (1, 2, 5, 10) if power * factor >= rough), rough)
    first, last = math.ceil(start / step - 1e-9), math.floor(end / step + 1e-9)
    return Axis(start, end, tuple(step * k for k in range(first, last + 1)), label=label)


def logarithmic(values: Iterable[float], label: str = "") -> Axis:
    """Return an axis over the positive finite values, with powers of ten at its ends."""
    finite = [value for value in values if math.isfinite(value) and value > 0]
    first = math.floor(math.log10(min(finite, default=1.0)) + 1e-9)
    first = min(max(first, -LARGEST + 1), LARGEST - 1)
    last = min(math.ceil(math.log10(max(finite, default=1.0)) - 1e-9), LARGEST)
    last = max(last, first + 1)
    step = math.ceil((last - first) / MOST_TICKS)
    ticks = tuple(10.0**power for power in range(first, last + 1, step))
    return Axis(10.0**first, 10.0**last, ticks, is_logarithmic=True, label=label)


def square(center: tuple[float, float], reach: float, labels: tuple[str, str]) -> tuple[Axis, Axis]:
    """Return axes of equal scale on a chart; y extends by ``reach`` on both sides of the centre."""
    halves = (reach * SHAPE, reach)
    x, y = (
        linear([middle - half, middle + half], label, low=None)
        for middle, half, label in zip(center, halves, labels, strict=True)
    )
    return x, y


def round_down(value: float, slack: float = 1e-12) -> float:
    """Return the largest 1, 2 or 5 times a power of ten up to a value; 1 if it is not positive.

    Args:
        value: value to round down.
        slack: share by which the result may exceed the value.
    """
    if not math.isfinite(value) or value <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return max(k * power for k in (1, 2, 5, 10) if k * power <= value * (1 + slack))


def short(value: float) -> str:
    """Return a short text for a number: 0.01, 250, 12k, 3M, 1e-7."""
    size = abs(value)
    if size == 0 or 1e-3 <= size < 1e4:
        return f"{value:.4g}"
    for limit, letter in ((1e6, "k"), (1e9, "M")):
        if 1e4 <= size < limit:
            return f"{value * 1e3 / limit:.4g}{letter}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"
