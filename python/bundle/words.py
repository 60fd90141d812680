"""How numbers and counts look in sentences, in a terminal, a notebook and a page alike."""

from __future__ import annotations

import math

__all__ = ["format_name", "number", "pixels", "plural", "seconds"]


def number(value: float) -> str:
    """Return a magnitude in four significant digits; "-" where there is none."""
    if not math.isfinite(value):
        return "-"
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    return f"{value:.3e}"


def pixels(value: float) -> str:
    """Return pixels to a ten-thousandth; "-" where there is none."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.4f}" if value < 1e6 else f"{value:.4e}"


def seconds(value: float) -> str:
    """Return a time to the millisecond; "-" where it was not measured (Ceres' -1)."""
    return "-" if value < 0 or not math.isfinite(value) else f"{value:.3f}"


def plural(count: int, singular: str, many: str | None = None, *, grouped: bool = False) -> str:
    """Return "1 image", "2 images"; with ``grouped`` "1,200 images"."""
    figure = f"{count:,}" if grouped else f"{count}"
    return f"{figure} {singular if count == 1 else many or singular + 's'}"


def format_name(name: str) -> str:
    """Return a format as people write it: "COLMAP", "BAL", "COLMAP text"."""
    return name.replace("-", " ").replace("colmap", "COLMAP").replace("bal", "BAL")
