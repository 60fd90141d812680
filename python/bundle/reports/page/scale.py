"""Axes of a chart: where numbers fall, and which of them are written at the axis."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Scale", "linear", "logarithmic", "short"]

MOST_TICKS = 6


@dataclass(frozen=True)
class Scale:
    """An axis from ``low`` to ``high`` with its ticks; positions go from 0 to 1."""

    low: float
    high: float
    ticks: tuple[float, ...]
    is_logarithmic: bool = False

    def __call__(self, value: float) -> float:
        """Return where the value falls, 0 at ``low`` and 1 at ``high``, never outside."""
        if self.is_logarithmic:
            value, low, high = (math.log(max(x, 1e-300)) for x in (value, self.low, self.high))
        else:
            low, high = self.low, self.high
        return min(max((value - low) / (high - low), 0.0), 1.0)


def linear(values: Iterable[float], *, low: float | None = 0.0) -> Scale:
    """Return an axis over the finite values, with round ticks."""
    finite = [value for value in values if math.isfinite(value)]
    start = min(finite, default=0.0) if low is None else low
    end = max([*finite, start])
    if end <= start:
        end = start + 1.0
    rough = (end - start) / (MOST_TICKS - 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough)
    first, last = math.ceil(start / step - 1e-9), math.floor(end / step + 1e-9)
    return Scale(start, end, tuple(step * k for k in range(first, last + 1)))


def logarithmic(values: Iterable[float]) -> Scale:
    """Return an axis over the positive finite values, its ends at powers of ten."""
    finite = [value for value in values if math.isfinite(value) and value > 0]
    first = math.floor(math.log10(min(finite, default=1.0)) + 1e-9)
    last = math.ceil(math.log10(max(finite, default=1.0)) - 1e-9)
    last = max(last, first + 1)
    step = math.ceil((last - first) / MOST_TICKS)
    ticks = tuple(10.0**power for power in range(first, last + 1, step))
    return Scale(10.0**first, 10.0**last, ticks, is_logarithmic=True)


def short(value: float) -> str:
    """Return a number in as few characters as an axis wants: 0.01, 250, 12k, 3M, 1e-7."""
    size = abs(value)
    if size == 0 or 1e-3 <= size < 1e4:
        return f"{value:.4g}"
    for limit, letter in ((1e6, "k"), (1e9, "M")):
        if 1e4 <= size < limit:
            return f"{value * 1e3 / limit:.4g}{letter}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"
