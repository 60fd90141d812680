"""Fields of option classes: value, flag, help and range declared once, checked in one way."""

from __future__ import annotations

import dataclasses
import math
import operator
from typing import Any

from bundle.errors import InputError

__all__ = ["checked", "choice", "option"]

LARGEST_WHOLE = 2**31 - 1


def option(
    default: Any,
    flag: str,
    help: str,
    *,
    choices: tuple[str, ...] | None = None,
    minimum: float | None = None,
    above: float | None = None,
    below: float | None = None,
    maximum: float | None = None,
    metavar: str | tuple[str, ...] | None = None,
) -> Any:
    """Return a dataclass field with what the command line and :func:`checked` need to know.

    The type of the default is the type of the option: str with ``choices``, bool, int, float, or a
    tuple of whole numbers of that length. Whole numbers go up to 2^31 - 1 unless ``maximum`` says
    otherwise.
    """
    metadata = {
        "flag": flag,
        "help": help,
        "choices": choices,
        "minimum": minimum,
        "above": above,
        "below": below,
        "maximum": maximum,
        "metavar": metavar,
    }
    return dataclasses.field(default=default, metadata=metadata)


def checked(field: dataclasses.Field[Any], value: Any) -> Any:
    """Return the value in canonical form.

    Raises:
        InputError: the value is not of the option's type or range; the message names both.
    """
    if field.metadata["choices"] is not None:
        return choice(field.name, value, field.metadata["choices"])
    if isinstance(field.default, bool):
        if not isinstance(value, bool):
            raise InputError(f"{field.name}: expected True or False, found {value!r}")
        return value
    if isinstance(field.default, tuple):
        if not isinstance(value, tuple | list) or len(value) != len(field.default):
            raise InputError(
                f"{field.name}: expected {len(field.default)} whole numbers, found {value!r}"
            )
        return tuple(_number(field, entry, whole=True) for entry in value)
    return _number(field, value, whole=isinstance(field.default, int))


def choice(name: str, value: Any, choices: tuple[str, ...]) -> str:
    """Return the choice that is meant, in any case, with hyphens or underscores.

    Raises:
        InputError: none is.
    """
    canonical = str(value).lower().replace("-", "_")
    for candidate in choices:
        if canonical == candidate.lower():
            return candidate
    raise InputError(f"{name}: expected one of {', '.join(choices)}, found {value!r}")


def _number(field: dataclasses.Field[Any], value: Any, *, whole: bool) -> int | float:
    number: int | float = 0
    try:
        number = int(value) if whole else float(value)
        exact = math.isfinite(number) and (not whole or number == float(value))
    except (TypeError, ValueError, OverflowError):
        exact = False
    if not exact:
        kind = "a whole number" if whole else "a finite number"
        raise InputError(f"{field.name}: expected {kind}, found {value!r}")
    limits = field.metadata
    for limit, fits, words in (
        (limits["minimum"], operator.ge, "at least"),
        (limits["above"], operator.gt, "more than"),
        (limits["below"], operator.lt, "less than"),
        (limits["maximum"] or (LARGEST_WHOLE if whole else math.inf), operator.le, "at most"),
    ):
        if limit is not None and not fits(number, limit):
            shown = limit if isinstance(limit, int) else f"{limit:g}"
            raise InputError(f"{field.name}: expected {words} {shown}, found {value!r}")
    return number
