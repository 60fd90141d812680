"""Path arguments of a command, and a check of all of them together.

The type of an argument declares its use: reading, or writing of a named content. Before a command
runs, the check compares all paths. A written path must differ from all read paths and all other
written paths, and from the files of models and sequences at these paths. Existing files are
compared by identity, so links and different spellings are detected. Outputs that do not exist yet
are compared by folder and name.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from bundle.base.records import dataclass
from bundle.errors import InputError, shown
from bundle.io.atomic import atomic_write as atomic
from bundle.io.atomic.replaced_paths import MODEL_FILES, is_stream
from bundle.io.georeference_file import GEOREFERENCE
from bundle.io.recognition import PAGE, SEQUENCE_FILES, check_name, reconstruction_at

_OF_SENSORS = [
    f"{each}/{name}" for each in ("cam0", "imu0") for name in ("data.csv", "sensor.yaml")
]
_OF_A_FOLDER = (
    *(*MODEL_FILES, *SEQUENCE_FILES, "ground_truth.csv", GEOREFERENCE),
    *(*_OF_SENSORS, *(f"mav0/{name}" for name in _OF_SENSORS)),
)


@dataclass(frozen=True)
class PathArgument:
    """Type of an argument that is a path."""

    written: str = ""  # content that the command writes, such as "page"; empty: the path is read
    is_data: bool = False  # True for the file or folder of a model, pose graph or sequence
    replaces: tuple[str, ...] = ()  # destinations of arguments that may have the same path
    words: tuple[str, ...] = ()  # values that are not paths
    format: str = ""  # format for the check of the name by :func:`check_name`; empty: any name
    own: str = ""  # suffixes of that format
    # function that returns the path of a file that is written by default
    otherwise: Callable[[argparse.Namespace], str | None] | None = None

    def __call__(self, text: str) -> str:
        """Return the path."""
        if not text.strip():
            raise argparse.ArgumentTypeError("expected a path, found an empty string")
        return text


a_path = PathArgument()
"""Type of a path that is read and is not a model or sequence."""

reconstruction = PathArgument(is_data=True)
"""Type of a path of a model, a pose graph or a sequence that is read."""


_JSON = ".json .jsonl .ndjson .yaml .yml .txt"  # JSON is also valid YAML and text
report_path = PathArgument("report", format="a report (.json)", own=_JSON)
telemetry_path = PathArgument("telemetry", format="lines of JSON (.jsonl)", own=_JSON)
trajectory_path = PathArgument("trajectory", format="a trajectory (.tum)", own=".tum .txt")


def page_path(written: str = "page") -> PathArgument:
    """Return the type of a path of a page."""
    return PathArgument(written, format=PAGE[0], own=PAGE[1])


@dataclass(frozen=True)
class _Given:
    """Given path with its argument."""

    kind: PathArgument
    argument: str
    name: str
    path: str

    def identity(self) -> tuple[Any, ...]:
        return _identity(self.path)

    def identities(self) -> set[tuple[Any, ...]]:
        """Return the identities of the path and of all files that belong to it."""
        found = {self.identity()}
        if self.kind.is_data:
            folder = Path(self.path)
            found |= {_identity(folder / name) for name in _OF_A_FOLDER}
            if not (folder.is_dir() or self.path.endswith("/")):
                found.add(_identity(Path(_real(self.path)).parent / GEOREFERENCE))
        return found


def check_paths(actions: Iterable[argparse.Action], arguments: argparse.Namespace) -> None:
    """Refuse paths that would replace each other, and paths that cannot be written later.

    A suffix of another format, a folder in place of a file, and a reconstruction are refused, too.
    """
    arguments.paths = given = list(_given(actions, arguments))
    known = [one for one in given if not one.kind.written]
    written = [one for one in given if one.kind.written and not is_stream(one.path)]
    for one in sorted(written, key=lambda one: not one.kind.is_data):
        for other in known:
            allowed = other.argument in one.kind.replaces or one.argument in other.kind.replaces
            if not allowed and _meet(one, other):
                raise InputError(
                    f"{shown(one.path)}: the {one.kind.written} would replace the file of "
                    f"{other.name}"
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
    """Return device and inode of the nearest existing path, and the names below it."""
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
    except (OSError, ValueError):  # zero byte in the name: opening the file reports it
        return os.fspath(path)
