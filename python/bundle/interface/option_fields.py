"""Fields of option classes, which declare value, flag, help and range in one place.

:func:`option` makes a field. Classes that hold such fields derive from
:class:`bundle.interface.option_class.Options`. Command-line flags, error messages, documentation
and typed keywords are all generated from the fields.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import operator
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal, overload

import numpy as np

from bundle.base.arrays import check_type, distinct
from bundle.errors import InputError, brief, nearest

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
    value: str = "",
    unset: str = "none",
    negatable: bool = True,
    only_with: tuple[str, tuple[Any, ...]] | None = None,
    idle: str = "error",
    needs: tuple[str, ...] = (),
    late: bool = False,
    use: int = 0,
) -> Any:
    """Return a dataclass field with the metadata of the command line and of :func:`checked`.

    The type of the default is the type of the option: str with ``choices``, bool, int, float, or a
    tuple of whole numbers of that length. Whole numbers go up to 2^31 - 1 unless ``maximum`` is
    given. If the default is None or a text without choices, the option accepts any text.

    Args:
        default: default value.
        flag: flag of the command line.
        help: meaning, with the unit.
        choices: all allowed values, for an option that is a word.
        minimum: smallest allowed number.
        above: number that the value must exceed.
        below: number that the value must stay below.
        maximum: largest allowed number.
        metavar: placeholder in the help of the command line.
        value: how the command line reads the value, one of ``bundle.cli.option_flags.READERS``;
            "": by the type of the default.
        unset: default in words, if the default is None.
        negatable: for bool: also add a ``--no-`` flag to the command line.
        only_with: another option, and its values with which this option has an effect.
        idle: treatment of a value without effect. "error": the user would expect another result.
            "note" (a warning of the solve): only the way to the result would differ.
        needs: other options. The command line requires one of them together with this option.
        late: leave the check of the value to the function that uses it.
        use: place in the short help of a command, in the order of use; 0: only in ``--help-all``.
    """
    metadata = dict(locals())
    return dataclasses.field(default=metadata.pop("default"), metadata=metadata)


def same(kind: Any, name: str, **changes: Any) -> Any:
    """Return a field with the declaration of an option of another class, and some changes."""
    field = kind.__dataclass_fields__[name]
    return option(**{"default": field.default, **field.metadata, **changes})


def checked(field: dataclasses.Field[Any], value: Any) -> Any:
    """Return the value in canonical form."""
    choices = field.metadata["choices"]
    if field.metadata["late"] or (isinstance(field.default, str | type(None)) and not choices):
        return value
    if choices is not None:
        return choice(field.name, value, choices)
    if isinstance(field.default, bool):
        check_type(field.name, value, bool, "True or False")
        return value
    if isinstance(field.default, tuple):
        if not isinstance(value, tuple | list) or len(value) != len(field.default):
            raise InputError(
                f"{field.name}: expected {len(field.default)} whole numbers, found {brief(value)}"
            )
        return tuple(_number(field.name, entry, field.metadata, whole=True) for entry in value)
    return _number(field.name, value, field.metadata, whole=isinstance(field.default, int))


def choice(name: str, value: Any, choices: Iterable[str]) -> str:
    """Return the choice that equals a value; case, hyphens and underscores are ignored."""
    expected = tuple(choices)
    hint = ""
    if type(value) is str and value in expected:
        return value
    if isinstance(value, str):
        canonical = value.lower().replace("-", "_")
        for candidate in expected:
            if canonical == candidate.lower().replace("-", "_"):
                return candidate
        hint = nearest(value, expected)
    raise InputError(f"{name}: expected one of {', '.join(expected)}, found {brief(value)}{hint}")


@overload
def number(name: str, value: Any, *, whole: Literal[True], **limits: float) -> int: ...


@overload
def number(name: str, value: Any, *, whole: Literal[False] = False, **limits: float) -> float: ...


def number(name: str, value: Any, *, whole: bool = False, **limits: float) -> int | float:
    """Check a numeric argument and return it; ``limits`` are as for :func:`option`.

    Raises:
        InputError: the argument is not a number, or is out of its range.
    """
    return _number(name, value, limits, whole=whole)


def _number(name: str, value: Any, limits: Mapping[str, Any], *, whole: bool) -> int | float:
    found: int | float = 0
    exact = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if exact:
        try:
            found = int(value) if whole else float(value)
            exact = math.isfinite(found) and (not whole or found == value)
        except (ArithmeticError, TypeError, ValueError):
            exact = False
    if not exact:
        kind = "a whole number" if whole else "a finite number"
        raise InputError(f"{name}: expected {kind}, found {brief(value)}")
    for limit, words, fits in _limits(limits, whole=whole):
        if not fits(found, limit):
            raise InputError(f"{name}: expected {words} {_shown(limit)}, found {brief(value)}")
    return found


Limit = tuple[float, str, Callable[[Any, Any], bool]]


def limits_of(field: dataclasses.Field[Any]) -> list[str]:
    """Return the bounds of a numeric option, such as "at least 0"."""
    if isinstance(field.default, bool):
        return []
    bounds = _limits(field.metadata, whole=False)
    return [f"{words} {_shown(limit)}" for limit, words, _ in bounds if math.isfinite(limit)]


def _limits(limits: Mapping[str, Any], *, whole: bool) -> list[Limit]:
    """Return (limit, words, comparison) for each bound of a number."""
    largest = LARGEST_WHOLE if whole else math.inf
    every = (
        (limits.get("minimum"), "at least", operator.ge),
        (limits.get("above"), "more than", operator.gt),
        (limits.get("below"), "less than", operator.lt),
        (limits.get("maximum") or largest, "at most", operator.le),
    )
    return [(limit, words, fits) for limit, words, fits in every if limit is not None]


def _shown(limit: float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:g}"


SENSORS = "sensor_from_rig"  # additional name in ``refine``, for ``refine_sensor_from_rig``
REFINABLE = ("poses", "points", "focal", "principal_point", "extra")


def refined_names(value: Any) -> tuple[str, ...]:
    """Return names of parameters in the order of the list; text has commas between them."""
    try:
        given = value.split(",") if isinstance(value, str) else list(value)
    except TypeError:
        raise InputError(
            f"refine: expected names out of {', '.join((*REFINABLE, SENSORS))}, "
            f"found {brief(value)}"
        ) from None
    words = (name.strip() if isinstance(name, str) else name for name in given)
    named = (word for word in words if not isinstance(word, str) or word)
    every = (*REFINABLE, SENSORS)
    chosen = {choice("refine", word, every) for word in named}
    return tuple(name for name in every if name in chosen)


def two_sigmas(value: Any) -> tuple[float, ...]:
    """Return the sigmas of the angular and the other part of a twist; () without any."""
    if isinstance(value, tuple | list) and not value:
        return ()
    expected = f"twist_sigma: expected two numbers above 0, found {brief(value)}"
    try:
        parts = value.split(",") if isinstance(value, str) else list(value)
        w, v = (float(part) for part in parts)
    except (TypeError, ValueError):
        raise InputError(expected) from None
    if not (0 < w < float("inf") and 0 < v < float("inf")):
        raise InputError(expected)
    return w, v


def sensor_pairs(value: Any) -> tuple[tuple[int, int], ...]:
    """Return pairs (rig id, camera id)."""
    expected = "fixed_sensors: expected pairs (rig id, camera id), found "
    try:
        if isinstance(value, str | bytes | dict):
            raise TypeError
        given = [tuple(entry) for entry in value]
        if any(len(pair) != 2 or any(isinstance(x, bool) for x in pair) for pair in given):
            raise TypeError
        pairs = {(operator.index(rig), operator.index(camera)) for rig, camera in given}
    except TypeError:
        raise InputError(expected + brief(value)) from None
    for found in (entry for pair in pairs for entry in pair if not -(2**63) <= entry < 2**63):
        raise InputError(f"fixed_sensors: expected ids below 2^63, found {brief(found)}")
    return tuple(sorted(pairs))


def whole_ids(name: str, value: Any) -> tuple[int, ...]:
    """Return different ids, ascending."""
    try:
        if isinstance(value, str | bytes):
            raise TypeError  # the characters of a string are not ids
        if type(value) is np.ndarray and value.ndim == 1 and value.dtype.kind in "iu":
            ids = distinct(value).tolist()
        else:
            given = list(value)
            if bool in set(map(type, given)):
                raise TypeError
            ids = sorted(set(map(operator.index, given)))
    except TypeError:
        raise InputError(f"{name}: expected whole numbers, found {brief(value)}") from None
    for found in (*ids[:1], *ids[-1:]):
        if not -(2**63) <= found < 2**63:
            raise InputError(f"{name}: expected ids below 2^63, found {brief(found)}")
    return tuple(ids)
