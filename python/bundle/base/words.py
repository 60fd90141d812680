"""Formatting of numbers, counts and memory sizes for sentences."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from typing import Any, Protocol

from bundle.errors import InputError

_LISTED = 5  # ids that a sentence lists before it counts the others


def join(words: Iterable[str]) -> str:
    """Return "a", "a or b", "a, b or c"."""
    *most, last = words
    return f"{', '.join(most)} or {last}" if most else last


def few(words: Iterable[int | str], most: int = 3) -> str:
    """Return "a, b", or "a, b, c and 4 more" of more than ``most`` words."""
    listed = [*map(str, words)]
    more = f" and {len(listed) - most} more" if len(listed) > most else ""
    return ", ".join(listed[:most]) + more


def number(value: float) -> str:
    """Format a number with four significant digits; "-" if it is not finite."""
    if not math.isfinite(value):
        return "-"
    if value == 0 or 1e-3 <= abs(value) < 1e6:
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
    return f"{value:.3e}"


def rounded(value: float) -> str:
    """Format a number with two significant digits, such as "140"; "-" if it is not finite."""
    return f"{float(f'{value:.2g}'):g}" if math.isfinite(value) else "-"


def amount(value: float) -> str:
    """Format a count with all digits up to seven, else with three; "-" if it is not finite."""
    if not math.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) < 1e7 else f"{value:.2e}"


def distinct(one: float, other: float) -> tuple[str, str]:
    """Format two numbers with at least six digits, and enough digits that the texts differ."""
    for digits in range(6, 18):
        texts = f"{one:.{digits}g}", f"{other:.{digits}g}"
        if texts[0] != texts[1]:
            break
    return texts


def not_converged(percent: float, without_loss: bool) -> str:
    """Return the verdict "not converged", and advice: one more step would lower the cost."""
    sentence = (
        f"Not converged under these options: one more step would lower the cost by about "
        f"{number(percent)} %. "
    )
    if without_loss:
        return sentence + "If the model was refined with a loss (--loss), give it here too."
    return sentence + "Refine first, with the same options."


def pixels(value: float) -> str:
    """Format pixels with four decimals; "-" if the value is not finite."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.4f}" if value < 1e6 else f"{value:.4e}"


def seconds(value: float) -> str:
    """Format seconds with three decimals; "-" if the time was not measured (Ceres' -1)."""
    return "-" if value < 0 or not math.isfinite(value) else f"{value:.3f}"


def change(before: float, after: float) -> str:
    """Return "40944.1 -> 22913", with six significant digits."""
    return f"{before:.6g} -> {after:.6g}"


def duration(value: float) -> str:
    """Format a duration as "6.2 µs", "55 ms" or "1.2 s", with three digits; "-": unknown."""
    if not math.isfinite(value) or value < 0:
        return "-"
    if value < 0.9995e-3:
        return f"{1e6 * value:.3g} µs"
    if value < 0.9995:
        return f"{1e3 * value:.3g} ms"
    return f"{value:.3g} s" if value < 1e4 else f"{value:.1e} s"


def span(time: float) -> str:
    """Format a duration from "6.2 µs" to "3 days"; "-" if it is unknown."""
    if not math.isfinite(time) or time < 0:
        return "-"
    if time >= 2 * 86400:
        return f"{time / 86400:,.0f} days"
    if time >= 3600:
        return f"{time / 3600:.1f} h"
    if time >= 1:
        return f"{time:.1f} s" if time >= 10 else f"{time:.2f} s"
    return duration(time)


def plural(count: int, singular: str, many: str | None = None, *, grouped: bool = False) -> str:
    """Return "1 image", "2 images"; with ``grouped`` "1,200 images"."""
    figure = f"{count:,}" if grouped else f"{count}"
    return f"{figure} {singular if count == 1 else many or singular + 's'}"


class Counts(Protocol):
    """The sizes of a problem."""

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


FORMATS = ("bal", "colmap", "bundler", "opensfm", "nvm", "openmvg")
"""Formats of files that hold a reconstruction."""

_NAMES = {
    "bal": "BAL",
    "colmap": "COLMAP",
    "colmap-text": "COLMAP text",
    "bundler": "Bundler",
    "opensfm": "OpenSfM",
    "nvm": "NVM",
    "openmvg": "OpenMVG",
    "transforms": "transforms.json",
    "ply": "PLY",
    "rerun": "rerun",
}


def format_name(name: str) -> str:
    """Return the name of a file format in text: "COLMAP", "BAL", "COLMAP text"."""
    return _NAMES.get(name, name)


def named(what: str, ids: Iterable[int | str]) -> str:
    """Return "image 3", "images 3, 4" or "images 3, 4, 5, 6, 7 and 12 more"."""
    listed = [*ids]
    return f"{what}{'' if len(listed) == 1 else 's'} {few(listed, _LISTED)}"


def noun(count: int, one: str, many: str) -> str:
    """Return the singular or plural of a noun for a count."""
    return one if count == 1 else many


def sorted_ids(ids: Any, rows: Any) -> tuple[int, ...]:
    """Return the ids in some rows of an array, ascending."""
    return tuple(sorted(ids[rows].tolist()))


SHARE_OF_FREE_MEMORY = 0.9  # fraction of the free memory that a solve may use

_UNITS = {"": 1, "B": 1}
for _power, _letter in enumerate("KMGT", start=1):
    _UNITS |= {f"{_letter}B": 1000**_power, f"{_letter}IB": 1024**_power}


def parse_size(text: str) -> int:
    """Parse a size such as "500MB", "2 GiB" or "1000000"; return bytes."""
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?) *([A-Za-z]*)", text.strip())
    unit = _UNITS.get(match[2].upper()) if match else None
    size = float(match[1]) * unit if match and unit else 0
    if not 1 <= size < 2**63:
        raise InputError(f"expected a size such as 500MB or 2GiB, found {text!r}")
    return int(size)


def format_size(size: float) -> str:
    """Format bytes as "500 MB", in powers of 1000 with three digits; "-" if not positive."""
    if not math.isfinite(size) or size <= 0:
        return "-"
    for unit in ("B", "kB", "MB", "GB"):
        if size < 999.5:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB" if size < 999.5 else f"{size:.0f} TB"
