"""Paths as users hand them in."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, TypeGuard

from bundle.errors import InputError, brief

__all__ = ["as_path", "is_path"]


def as_path(path: Any, name: str = "path") -> Path:
    """Return a path that the system can be asked for.

    Raises:
        InputError: it is no path, is empty, or holds characters that no path has.
    """
    if not is_path(path):
        raise InputError(f"{name}: expected a path, found {brief(path)}")
    text = os.fspath(path)
    if text == "":
        raise InputError(f"{name}: expected a path, found an empty one")
    try:
        valid = b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        valid = False
    if not valid:
        raise InputError(f"{name}: expected a path of this system, found {brief(text)}")
    return Path(text)


def is_path(value: Any) -> TypeGuard[str | os.PathLike[str]]:
    """Tell whether a value is a path by its type, and not one of bytes."""
    return isinstance(value, str) or (
        isinstance(value, os.PathLike) and isinstance(os.fspath(value), str)
    )
