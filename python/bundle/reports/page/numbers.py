"""How numbers look on a page."""

from __future__ import annotations

import math

from bundle.base.words import plural

__all__ = ["amount", "amount_if_any", "counted", "seconds"]


def amount(value: float) -> str:
    """Return a count in full up to seven digits, else with three of them; "-" for none."""
    if not math.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) < 1e7 else f"{value:.2e}"


def amount_if_any(value: float) -> str:
    """Return a count; "-" where there is nothing to count."""
    return amount(value) if value else "-"


def counted(number: int, what: str) -> str:
    """Return "1 camera", "1,200 cameras"."""
    return plural(number, what, grouped=True)


def seconds(time: float) -> str:
    """Return a duration; "-" where there is none."""
    if not math.isfinite(time) or time < 0:
        return "-"
    if time >= 2 * 86400:
        return f"{time / 86400:,.0f} days"
    if time >= 3600:
        return f"{time / 3600:.1f} h"
    if time >= 1:
        return f"{time:.1f} s" if time >= 10 else f"{time:.2f} s"
    return f"{1e3 * time:.3g} ms"
