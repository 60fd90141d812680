"""What can be asked for of a covariance."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from bundle.errors import InputError, brief

__all__ = ["GAUGES", "PARTS", "ROBUST", "SCALES", "one_of", "parts_of"]

PARTS = ("poses", "points", "intrinsics")
GAUGES = ("inner", "two_cameras", "three_points", "none")
SCALES = ("unit", "sigma0")
ROBUST = ("weights", "sandwich")


def one_of(name: str, value: Any, choices: tuple[str, ...]) -> str:
    """Return the choice that a word is, hyphens and capitals aside.

    Raises:
        InputError: it is none.
    """
    word = value.lower().replace("-", "_") if isinstance(value, str) else value
    if word not in choices:
        expected = ", ".join(choices[:-1])
        raise InputError(f"{name}: expected {expected} or {choices[-1]}, found {brief(value)}")
    return str(word)


def parts_of(name: str, value: str | Iterable[str]) -> tuple[str, ...]:
    """Return the parts that are named, in the order of ``PARTS``.

    Raises:
        InputError: a name is none of them, or there is none.
    """
    words = value.split(",") if isinstance(value, str) else list(value)
    named = {one_of(name, word.strip() if isinstance(word, str) else word, PARTS) for word in words}
    if not named:
        raise InputError(f"{name}: expected some of {', '.join(PARTS)}, found none")
    return tuple(part for part in PARTS if part in named)
