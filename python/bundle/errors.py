"""Exception for invalid input, and formatting of values in its messages."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

from bundle._core import InputError, end_in_one_line

__all__ = [
    "InputError",
    "brief",
    "check_keywords",
    "end_in_one_line",
    "first_line",
    "nearest",
    "shown",
]

InputError.__doc__ = """Input that cannot be used: one line with place, expected and found."""

LONGEST_VALUE = 60


def shown(path: str | os.PathLike[str]) -> str:
    """Return the path as one line of printable text, even if its name has invalid bytes."""
    return _printable(os.fspath(path))


def brief(value: Any) -> str:
    """Return any value as one short line of printable text: its repr, or its type.

    A long repr is cut. Except for strings, the type is then written first.
    """
    try:
        text = " ".join(repr(value).split())[: LONGEST_VALUE + 1]
    except Exception:  # from a user's __repr__, or an incompletely built object
        return f"an object of type {type(value).__name__}"
    text = _printable(text)
    if len(text) <= LONGEST_VALUE:
        return text
    kind = "" if isinstance(value, str | bytes) else f"{type(value).__name__} "
    return f"{kind}{text[: LONGEST_VALUE - 3]}..."


def first_line(error: Exception) -> str:
    """Return the first line of an exception's message; the type if the message is empty."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def nearest(found: str, spellings: Mapping[str, str] | Iterable[str]) -> str:
    """Return "; did you mean X?", or "" if no valid name is similar.

    Case, hyphens and underscores are ignored.

    ``spellings``: valid names, or a table from other spellings to valid names.
    """
    import difflib

    table = spellings if isinstance(spellings, Mapping) else {name: name for name in spellings}
    plain = {_plain(spelling): name for spelling, name in table.items()}
    wanted = _plain(found)
    if wanted in plain:
        return f"; did you mean {plain[wanted]}?"
    close = difflib.get_close_matches(wanted, plain, n=3, cutoff=0.6)
    names = list(dict.fromkeys(plain[spelling] for spelling in close))
    return f"; did you mean {' or '.join(names)}?" if names else ""


ELSEWHERE = dict.fromkeys(
    ("num_rounds", "rounds", "max_error", "min_angle", "min_track_length"), "bundle.solve_rounds"
)
"""Functions that have the options which users look for in others."""


def check_keywords(caller: str, given: Iterable[str], spellings: Mapping[str, str]) -> None:
    """Raise an error for an unknown keyword, and suggest the most similar valid keyword.

    ``spellings``: table from every known spelling to the name of its option.
    """
    names = dict.fromkeys(spellings.values())
    for keyword in given:
        if keyword not in names:
            meant = f"; {function} has it" if (function := ELSEWHERE.get(keyword)) else ""
            meant = meant or nearest(keyword, spellings)
            expected = meant or f"; expected one of {', '.join(names)}"
            raise InputError(f"{caller}: there is no option {brief(keyword)}{expected}")


def _plain(name: str) -> str:
    return name.lower().replace("-", "_").strip("_")


def _printable(text: str) -> str:
    return "".join(
        character if character.isprintable() else ascii(character)[1:-1] for character in text
    )
