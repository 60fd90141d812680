"""The one exception for everything a user can get wrong, and how its messages show paths."""

from __future__ import annotations

import os

from bundle._core import InputError, end_in_one_line

__all__ = ["InputError", "end_in_one_line", "shown"]


def shown(path: str | os.PathLike[str]) -> str:
    """Return the path as one line of printable text, whatever bytes its name has."""
    return "".join(
        character if character.isprintable() else ascii(character)[1:-1]
        for character in os.fspath(path)
    )
