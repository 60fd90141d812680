"""Parsing and formatting of memory sizes, such as "500 MB"."""

from __future__ import annotations

import math
import re

from bundle.errors import InputError

SHARE_OF_FREE_MEMORY = 0.9
"""Fraction of the free memory that a solve may use."""

_UNITS = {"": 1, "B": 1}
for _power, _letter in enumerate("KMGT", start=1):
    _UNITS |= {f"{_letter}B": 1000**_power, f"{_letter}IB": 1024**_power}


def parse_size(text: str) -> int:
    """Parse a size such as "500MB", "2 GiB" or "1000000"; return bytes.

    Raises:
        InputError: the text is not a size, or is less than one byte.
    """
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
