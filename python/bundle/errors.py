"""The one exception for everything a user can get wrong, and how its messages show values."""

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
    """Return the path as one line of printable text, whatever bytes its name has."""
    return _printable(os.fspath(path))


def brief(value: Any) -> str:
    """Return any value as one short line of printable text: its repr, or its type.

    Of a long one the beginning, after the type where the quotes of a word do not tell it.
    """
    try:
        text = " ".join(repr(value).split())[: LONGEST_VALUE + 1]
    except Exception:  # a repr of the user's, or one of an object that is no longer whole
        return f"an object of type {type(value).__name__}"
    text = _printable(text)
    if len(text) <= LONGEST_VALUE:
        return text
    kind = "" if isinstance(value, str | bytes) else f"{type(value).__name__} "
    return f"{kind}{text[: LONGEST_VALUE - 3]}..."


def first_line(error: Exception) -> str:
    """Return the first line of what an exception of another library says, or its type."""
    return (str(error).splitlines() or [type(error).__name__])[0]


def nearest(found: str, spellings: Mapping[str, str] | Iterable[str]) -> str:
    """Return "; did you mean X?", or "" where nothing resembles what was found.

    Case, hyphens and underscores do not count.

    Args:
        found: what the user wrote.
        spellings: right names, or other spellings with the right name of each.
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


def check_keywords(caller: str, given: Iterable[str], spellings: Mapping[str, str]) -> None:
    """Refuse keywords that do not exist, and name the keyword that was probably meant.

    Args:
        caller: whose keywords they are.
        given: the keywords that were found.
        spellings: every spelling that is understood, with the name of the option.

    Raises:
        InputError: one does not exist.
    """
    names = dict.fromkeys(spellings.values())
    for keyword in given:
        if keyword not in names:
            expected = nearest(keyword, spellings) or f"; expected one of {', '.join(names)}"
            raise InputError(f"{caller}: there is no option {brief(keyword)}{expected}")


def _plain(name: str) -> str:
    return name.lower().replace("-", "_").strip("_")


def _printable(text: str) -> str:
    return "".join(
        character if character.isprintable() else ascii(character)[1:-1] for character in text
    )
