"""Paths among the arguments of a command, and the guard over all of them.

Each path is declared once, as the type of its argument: read, or written as what. Before a command
runs, no path that it writes may be, by the identity of the file, one that it reads or also writes,
nor a file of a model or sequence there. Links and different spellings do not hide that, and two
outputs that do not exist yet are compared by their folder and name.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bundle.errors import InputError, shown
from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic.model_files import MODEL_FILES
from bundle.io.atomic.special_paths import is_stream
from bundle.io.file_names import PAGE, check_name
from bundle.io.georeference_file import GEOREFERENCE
from bundle.io.recognition import SEQUENCE_FILES, reconstruction_at

__all__ = [
    "PathArgument",
    "a_path",
    "check_paths",
    "page_path",
    "reconstruction",
    "report_path",
    "telemetry_path",
    "trajectory_path",
]

_OF_A_FOLDER = (*MODEL_FILES, *SEQUENCE_FILES, "ground_truth.csv", GEOREFERENCE)


@dataclass(frozen=True)
class PathArgument:
    """Type of an argument that is a path.

    Attributes:
        written: what the command writes there, such as "page"; empty: it reads.
        is_data: it is the file or folder of a model, pose graph or sequence.
        replaces: destinations of arguments that it may be the same as.
        words: values that are no paths.
        format: what its name may say, for :func:`check_name`; empty: anything.
        own: suffixes of that format.
        otherwise: returns the path of a file that is written where none is given.
    """

    written: str = ""
    is_data: bool = False
    replaces: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    format: str = ""
    own: str = ""
    otherwise: Callable[[argparse.Namespace], str | None] | None = None

    def __call__(self, text: str) -> str:
        """Return the path.

        Raises:
            argparse.ArgumentTypeError: it is empty.
        """
        if not text.strip():
            raise argparse.ArgumentTypeError("expected a path, found an empty one")
        return text


a_path = PathArgument()
"""Type of the path of a file or folder that is read, and is no model or sequence."""

reconstruction = PathArgument(is_data=True)
"""Type of the path of a model, a pose graph or a sequence that is read."""


_JSON = ".json .jsonl .ndjson .yaml .yml .txt"  # JSON is YAML as well, and text
report_path = PathArgument("report", format="a report (.json)", own=_JSON)
telemetry_path = PathArgument("telemetry", format="lines of JSON (.jsonl)", own=_JSON)
trajectory_path = PathArgument("trajectory", format="a trajectory (.tum)", own=".tum .txt")


def page_path(written: str = "page") -> PathArgument:
    """Return the type of the path of a page."""
    return PathArgument(written, format=PAGE[0], own=PAGE[1])


@dataclass(frozen=True)
class _Given:
    """A path that was given, and the argument that has it."""

    kind: PathArgument
    argument: str
    name: str
    path: str

    def identity(self) -> tuple[Any, ...]:
        return _identity(self.path)

    def identities(self) -> set[tuple[Any, ...]]:
        """Return those of the path and of all files that belong to it."""
        found = {self.identity()}
        if self.kind.is_data:
            folder = Path(self.path)
            found |= {_identity(folder / name) for name in _OF_A_FOLDER}
            if not (folder.is_dir() or self.path.endswith("/")):
                found.add(_identity(Path(_real(self.path)).parent / GEOREFERENCE))
        return found


def check_paths(actions: Iterable[argparse.Action], arguments: argparse.Namespace) -> None:
    """Refuse paths of which one would replace another, and what could not be written later.

    Args:
        actions: the arguments of a command.
        arguments: what was given for them.

    Raises:
        InputError: see the head of this file; or a name says another format, the path of a file is
            a folder or has no folder to be in, or a reconstruction stands there.
        OSError: there is no permission to write.
    """
    given = list(_given(actions, arguments))
    known = [one for one in given if not one.kind.written]
    written = [one for one in given if one.kind.written and not is_stream(one.path)]
    for one in sorted(written, key=lambda one: not one.kind.is_data):
        for other in known:
            allowed = other.argument in one.kind.replaces or one.argument in other.kind.replaces
            if not allowed and _meet(one, other):
                raise InputError(
                    f"{shown(one.path)}: the {one.kind.written} would replace what {other.name} "
                    "names"
                )
        known.append(one)
        if not one.kind.is_data:
            _check_file(one)


def _given(actions: Iterable[argparse.Action], arguments: argparse.Namespace) -> Iterator[_Given]:
    for action in actions:
        kind = action.type
        if not isinstance(kind, PathArgument):
            continue
        value = getattr(arguments, action.dest, None)
        if value is None and kind.otherwise is not None:
            value = kind.otherwise(arguments)
        name = action.option_strings[-1] if action.option_strings else str(action.metavar)
        for path in value if isinstance(value, list) else [value]:
            if path and path not in ("-", *kind.words):
                yield _Given(kind, action.dest, name, path)


def _meet(one: _Given, other: _Given) -> bool:
    return one.identity() in other.identities() or other.identity() in one.identities()


def _check_file(one: _Given) -> None:
    path = Path(one.path)
    atomic.check_file(path)
    real = Path(_real(path))
    found = reconstruction_at(real)
    if found is not None:
        raise InputError(f"{shown(path)}: the {one.kind.written} would replace {found}")
    if one.kind.format:
        check_name(one.path, one.kind.format, one.kind.own)
        check_name(real, one.kind.format, one.kind.own)


def _identity(path: str | os.PathLike[str]) -> tuple[Any, ...]:
    """Return device and inode of the nearest thing that exists, and the names below it."""
    place, names = Path(_real(path)), []
    while True:
        try:
            status = place.stat()
        except (OSError, ValueError):
            if place.parent == place:
                return (str(path),)
            names.append(place.name)
            place = place.parent
        else:
            return (status.st_dev, status.st_ino, *names)


def _real(path: str | os.PathLike[str]) -> str:
    try:
        return os.path.realpath(path)
    except (OSError, ValueError):  # a zero in the name: who opens it says so
        return os.fspath(path)
