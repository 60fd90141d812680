"""Fields of option classes: value, flag, help and range declared once, checked in one way.

An option class is a frozen dataclass that derives from :class:`Options` and whose fields are made
by :func:`option`; :func:`documented` writes its docstring. The command line makes its flags from
the same fields.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
import operator
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Self, TypeVar, overload

from bundle.errors import InputError, brief, check_keywords, nearest

__all__ = ["Options", "checked", "choice", "documented", "number", "option", "spellings"]

LARGEST_WHOLE = 2**31 - 1

AnyOptions = TypeVar("AnyOptions", bound="Options")


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
    only_with: tuple[str, tuple[Any, ...]] | None = None,
    idle: str = "error",
) -> Any:
    """Return a dataclass field with what the command line and :func:`checked` need to know.

    The type of the default is the type of the option: str with ``choices``, bool, int, float, or a
    tuple of whole numbers of that length. Whole numbers go up to 2^31 - 1 unless ``maximum`` says
    otherwise.

    Args:
        default: value where nothing is given.
        flag: of the command line.
        help: meaning, with the unit.
        choices: all values, where they are words.
        minimum: smallest number.
        above: number that the value exceeds.
        below: number that the value stays below.
        maximum: largest number.
        metavar: placeholder in the help of the command line.
        only_with: another option, and its values with which this one has an effect.
        idle: what becomes of a value without effect: "error" where the user would expect another
            result, "note" (a warning of the solve) where only the way to the result would differ.
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
        "only_with": only_with,
        "idle": idle,
    }
    return dataclasses.field(default=default, metadata=metadata)


class Options:
    """What option classes have in common: checks, copies, and a repr of what was changed."""

    def __new__(cls, *args: Any, **given: Any) -> Self:
        """Refuse unknown options with a suggestion, before ``__init__`` raises a TypeError."""
        if args:
            raise InputError(f"{cls.__name__}: expected options by name, found {brief(args[0])}")
        check_keywords(cls.__name__, given, spellings(cls))
        return super().__new__(cls)

    def __post_init__(self) -> None:
        self._check(_declared(type(self)).fields)

    def _check(self, fields: Iterable[dataclasses.Field[Any]]) -> None:
        for field in fields:
            object.__setattr__(self, field.name, self._checked(field, getattr(self, field.name)))
        for field in self._idle():
            if field.metadata["idle"] == "error":
                other, values = field.metadata["only_with"]
                raise InputError(
                    f"{field.name}: expected with {other}={join(map(str, values))} only, "
                    f"found with {other}={getattr(self, other)}"
                )

    @classmethod
    def of(cls, options: Self | None, changes: Mapping[str, Any], caller: str) -> Self:
        """Return the options with some changed; the defaults where there are none.

        Raises:
            InputError: these are no options, or a change is wrong.
        """
        if options is None:
            options = _defaults(cls)
        if not isinstance(options, cls):
            raise InputError(f"options: expected {cls.__name__}, found {brief(options)}")
        return options._changed(caller, changes) if changes else options

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some options changed."""
        return self._changed(type(self).__name__, changes)

    def asdict(self) -> dict[str, Any]:
        """Return every option by name."""
        return {field.name: getattr(self, field.name) for field in _declared(type(self)).fields}

    def _changed(self, caller: str, changes: Mapping[str, Any]) -> Self:
        """Return a copy with changes, which alone are checked: the rest was."""
        check_keywords(caller, changes, spellings(type(self)))
        copy = object.__new__(type(self))
        copy.__dict__.update(self.__dict__, **changes)
        copy._check(field for field in _declared(type(self)).fields if field.name in changes)
        return copy

    def without_idle(self) -> Self:
        """Return a copy in which options without effect have their defaults."""
        return self.replace(**{field.name: field.default for field in self._idle()})

    def __repr__(self) -> str:
        changed = (
            f"{field.name}={getattr(self, field.name)!r}"
            for field in _declared(type(self)).fields
            if getattr(self, field.name) != field.default
        )
        return f"{type(self).__name__}({', '.join(changed)})"

    def _checked(self, field: dataclasses.Field[Any], value: Any) -> Any:
        """Return the value in canonical form; classes with options of their own kind override."""
        return checked(field, value)

    def _idle(self) -> list[dataclasses.Field[Any]]:
        """Return the options that were changed but have no effect."""
        idle = []
        for field in _declared(type(self)).dependent:
            value = getattr(self, field.name)
            zero = isinstance(value, float) and value == 0  # noise of something that is not there
            if value == field.default or zero:
                continue
            other, values = field.metadata["only_with"]
            if getattr(self, other) not in values:
                idle.append(field)
        return idle


def documented(kind: type[AnyOptions]) -> type[AnyOptions]:
    """Give an option class a docstring that lists every option, from its fields."""
    lines = [(kind.__doc__ or "").rstrip(), "", "    Attributes:"]
    for field in _declared(kind).fields:
        metavar = field.metadata["metavar"]
        value = " ".join(metavar) if isinstance(metavar, tuple) else metavar or ""
        choices = field.metadata["choices"]
        parts = [
            f"{field.metadata['help']}.",
            f"One of {', '.join(choices)}." if choices else _range(field),
            _only_with(field),
            f"Default {field.default!r};",
            f"command line: {field.metadata['flag']} {value}".rstrip() + ".",
        ]
        lines += _wrapped(f"{field.name}: {' '.join(filter(None, parts))}")
    kind.__doc__ = "\n".join(lines) + "\n"
    return kind


def spellings(kind: type[Options]) -> Mapping[str, str]:
    """Return every spelling of an option that is understood, the flags' among them."""
    return _declared(kind).spellings


def checked(field: dataclasses.Field[Any], value: Any) -> Any:
    """Return the value in canonical form.

    Raises:
        InputError: the value is not of the option's type or range; the message names both.
    """
    if field.metadata["choices"] is not None:
        return choice(field.name, value, field.metadata["choices"])
    if isinstance(field.default, bool):
        if not isinstance(value, bool):
            raise InputError(f"{field.name}: expected True or False, found {brief(value)}")
        return value
    if isinstance(field.default, tuple):
        if not isinstance(value, tuple | list) or len(value) != len(field.default):
            raise InputError(
                f"{field.name}: expected {len(field.default)} whole numbers, found {brief(value)}"
            )
        return tuple(_number(field.name, entry, field.metadata, whole=True) for entry in value)
    return _number(field.name, value, field.metadata, whole=isinstance(field.default, int))


def choice(name: str, value: Any, choices: Iterable[str]) -> str:
    """Return the choice that is meant, in any case, with hyphens or underscores.

    Raises:
        InputError: none is; the message names the nearest.
    """
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
    """Return an argument that is a number; ``limits`` are those of :func:`option`.

    Raises:
        InputError: it is no number, or out of its range.
    """
    return _number(name, value, limits, whole=whole)


def join(words: Iterable[str]) -> str:
    """Return "a", "a or b", "a, b or c"."""
    *most, last = words
    return f"{', '.join(most)} or {last}" if most else last


class _Declared(NamedTuple):
    """What is asked of a class again and again."""

    fields: tuple[dataclasses.Field[Any], ...]
    dependent: tuple[dataclasses.Field[Any], ...]
    spellings: Mapping[str, str]


def _declared(kind: Any) -> _Declared:
    return _cached_declared(kind)


@functools.cache
def _cached_declared(kind: Any) -> _Declared:
    fields = dataclasses.fields(kind)
    flags = {field.metadata["flag"]: field.name for field in fields}
    names = {field.name: field.name for field in fields}
    return _Declared(
        fields=fields,
        dependent=tuple(field for field in fields if field.metadata["only_with"] is not None),
        spellings=MappingProxyType(flags | names),
    )


def _defaults(kind: Any) -> Any:
    return _cached_defaults(kind)


@functools.cache
def _cached_defaults(kind: Any) -> Any:
    """Return the immutable defaults, checked once."""
    return kind()


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


def _range(field: dataclasses.Field[Any]) -> str:
    """Return "At least 0." or "More than 0, less than 1."; "" where there is no bound to tell."""
    if isinstance(field.default, bool):
        return ""
    told = [
        f"{words} {_shown(limit)}"
        for limit, words, _ in _limits(field.metadata, whole=False)
        if math.isfinite(limit)
    ]
    return f"{', '.join(told).capitalize()}." if told else ""


def _only_with(field: dataclasses.Field[Any]) -> str:
    if field.metadata["only_with"] is None:
        return ""
    other, values = field.metadata["only_with"]
    return f"Only with {other} {join(map(str, values))}."


def _shown(limit: float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:g}"


def _wrapped(text: str) -> list[str]:
    import textwrap

    return textwrap.wrap(
        " ".join(text.split()),
        100,
        initial_indent=" " * 8,
        subsequent_indent=" " * 12,
        break_on_hyphens=False,
    )
