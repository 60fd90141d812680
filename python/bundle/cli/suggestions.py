"""The nearest right word for a misspelt command, flag or value."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping

__all__ = ["unknown_command", "unknown_flag", "unknown_value"]

NEAR = 0.7
"""Similarity (difflib's ratio, 0 to 1) from which on a word is worth suggesting."""


def unknown_command(found: str, commands: Iterable[str]) -> str:
    """Return what is wrong with a command that does not exist."""
    names = list(commands)
    return f"expected a command, one of {', '.join(names)}, found {found!r}" + _meant(found, names)


def unknown_value(found: str, values: Iterable[str]) -> str:
    """Return what is wrong with a value that is none of the choices."""
    names = list(values)
    return f"invalid choice: expected one of {', '.join(names)}, found {found!r}" + _meant(
        found, names
    )


def unknown_flag(found: str, command: str, flags: Mapping[str, Iterable[str]]) -> str:
    """Return what is wrong with a flag, and which flag of which command comes nearest.

    A flag of the same command counts first, then the same flag of another command, then a similar
    one of another command.

    Args:
        found: the flag as typed, perhaps with its value: "--solvr=auto".
        command: the command it was given to; "" where none was.
        flags: the flags of each command.
    """
    name, _, _ = found.partition("=")
    words = f"unrecognized arguments: {found}"
    own = _nearest(name, flags.get(command, ()))
    if own:
        return f"{words}; did you mean {own}?"
    others = {other: list(names) for other, names in flags.items() if other != command}
    having = [other for other, names in others.items() if name in names]
    if having:
        verb = "has" if len(having) == 1 else "have"
        return f"{words}; {' and '.join(having[:3])} {verb} {name}"
    for other, names in others.items():
        near = _nearest(name, names)
        if near:
            return f"{words}; {other} has {near}"
    return words


def _meant(found: str, names: Iterable[str]) -> str:
    near = _nearest(found, names)
    return f"; did you mean {near}?" if near else ""


def _nearest(found: str, names: Iterable[str]) -> str:
    lowered = found.lower().replace("_", "-")
    return next(iter(difflib.get_close_matches(lowered, list(names), 1, NEAR)), "")
