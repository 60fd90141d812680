"""How numbers and counts look in sentences, in a terminal, a notebook and a page alike."""

from __future__ import annotations

import math
from typing import Protocol

__all__ = [
    "Counts",
    "amount",
    "change",
    "contents",
    "distinct",
    "duration",
    "format_name",
    "not_converged",
    "number",
    "pixels",
    "plural",
    "seconds",
    "span",
]


def number(value: float) -> str:
    """Return a magnitude in four significant digits; "-" where there is none."""
    if not math.isfinite(value):
        return "-"
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    return f"{value:.3e}"


def amount(value: float) -> str:
    """Return a count in full up to seven digits, else with three of them; "-" for none."""
    if not math.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) < 1e7 else f"{value:.2e}"


def distinct(one: float, other: float) -> tuple[str, str]:
    """Return two numbers with as many digits, six or more, as it takes to tell them apart."""
    for digits in range(6, 18):
        texts = f"{one:.{digits}g}", f"{other:.{digits}g}"
        if texts[0] != texts[1]:
            break
    return texts


def not_converged(percent: float, without_loss: bool) -> str:
    """Return what to do where one more step would lower the cost, by percent of it."""
    sentence = (
        f"Not converged under these options: one more step would lower the cost by about "
        f"{number(percent)} %. "
    )
    if without_loss:
        return sentence + "If the model was refined with a loss (--loss), give it here too."
    return sentence + "Refine first, with the same options."


def pixels(value: float) -> str:
    """Return pixels to a ten-thousandth; "-" where there is none."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.4f}" if value < 1e6 else f"{value:.4e}"


def seconds(value: float) -> str:
    """Return a time to the millisecond; "-" where it was not measured (Ceres' -1)."""
    return "-" if value < 0 or not math.isfinite(value) else f"{value:.3f}"


def change(before: float, after: float) -> str:
    """Return "40944.1 -> 22913", in six significant digits."""
    return f"{before:.6g} -> {after:.6g}"


def duration(value: float) -> str:
    """Return "55 ms" or "1.2 s", in three digits; "-" where there is none."""
    if not math.isfinite(value) or value < 0:
        return "-"
    if value < 0.9995:
        return f"{1e3 * value:.3g} ms"
    return f"{value:.3g} s" if value < 1e4 else f"{value:.1e} s"


def span(time: float) -> str:
    """Return a duration from "5 ms" to "3 days"; "-" where there is none."""
    if not math.isfinite(time) or time < 0:
        return "-"
    if time >= 2 * 86400:
        return f"{time / 86400:,.0f} days"
    if time >= 3600:
        return f"{time / 3600:.1f} h"
    if time >= 1:
        return f"{time:.1f} s" if time >= 10 else f"{time:.2f} s"
    return f"{1e3 * time:.3g} ms"


def plural(count: int, singular: str, many: str | None = None, *, grouped: bool = False) -> str:
    """Return "1 image", "2 images"; with ``grouped`` "1,200 images"."""
    figure = f"{count:,}" if grouped else f"{count}"
    return f"{figure} {singular if count == 1 else many or singular + 's'}"


class Counts(Protocol):
    """Whatever has the sizes of a problem."""

    @property
    def num_images(self) -> int:
        """Number of images."""

    @property
    def num_cameras(self) -> int:
        """Number of cameras."""

    @property
    def num_points(self) -> int:
        """Number of points."""

    @property
    def num_observations(self) -> int:
        """Number of observations."""


def contents(of: Counts) -> str:
    """Return "16 images, 1 camera, 22106 points, 83718 observations"."""
    counts = (of.num_images, of.num_cameras, of.num_points, of.num_observations)
    return ", ".join(map(plural, counts, ("image", "camera", "point", "observation")))


def format_name(name: str) -> str:
    """Return a format as people write it: "COLMAP", "BAL", "COLMAP text"."""
    return name.replace("-", " ").replace("colmap", "COLMAP").replace("bal", "BAL")
