"""What stands for a problem or a path wherever a user hands one in."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard

from bundle.errors import InputError, brief
from bundle.problem import Problem

if TYPE_CHECKING:
    import pycolmap

__all__ = ["Source", "as_path", "as_problem", "is_path"]

Source: TypeAlias = "Problem | str | os.PathLike[str] | pycolmap.Reconstruction"
"""A problem, the path of one, or a reconstruction in memory."""


def as_problem(source: Source, name: str = "problem") -> Problem:
    """Return the problem that is meant: itself, what a path holds, or a reconstruction's.

    Args:
        source: any of these.
        name: of the argument, for errors.

    Raises:
        InputError: it is none of these, or what it stands for is no problem.
        OSError: the path does not exist or cannot be read.
    """
    if isinstance(source, Problem):
        return source
    if is_path(source):
        from bundle.io import load

        return load(source)
    # Whoever holds a reconstruction has imported pycolmap, which takes a while.
    pycolmap = sys.modules.get("pycolmap")
    if pycolmap is not None and isinstance(source, pycolmap.Reconstruction):
        return Problem.from_pycolmap(source)
    raise InputError(
        f"{name}: expected a Problem, a path or a pycolmap.Reconstruction, "
        f"found {brief(source)}{_hint(source)}"
    )


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
    """Whether a value is a path by its type, and not one of bytes."""
    return isinstance(value, str) or (
        isinstance(value, os.PathLike) and isinstance(os.fspath(value), str)
    )


def _hint(source: Any) -> str:
    problem = getattr(source, "problem", None)
    return "; pass its .problem" if isinstance(problem, Problem) else ""
