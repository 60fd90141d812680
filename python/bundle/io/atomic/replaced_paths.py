"""Paths of outputs: those replaced, files of a model, streams and mount points.

If a command fails, its error lists the files that it had already written. This module imports
almost nothing, because the command line needs it before it has parsed its arguments.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DEPTH = 3  # depth of the search for models below a folder: projects store them in dense/0/sparse/
MOST_FOLDERS = 1000  # largest number of folders to search for a hint

_REQUIRED = ("cameras", "images", "points3D")
_OPTIONAL = ("rigs", "frames")
_SUFFIXES = (".bin", ".txt")

ROLLING_SHUTTER = "rolling_shutter.json"
"""File with the rolling shutters of a model; COLMAP does not know it."""
MODEL_FILES = frozenset(
    [*(stem + suffix for stem in _REQUIRED + _OPTIONAL for suffix in _SUFFIXES), ROLLING_SHUTTER]
)


def missing_model_files(folder: Path) -> tuple[str, ...]:
    """Return the files that a folder lacks to be a COLMAP model; () if the model is complete.

    The result is for the format, binary or text, with fewer missing files. On a tie it is for
    binary, which COLMAP prefers.
    """
    return min((_missing(folder, suffix) for suffix in _SUFFIXES), key=len)


def is_text_model(folder: Path) -> bool:
    """Return True if the folder holds a text COLMAP model but no binary one."""
    return bool(_missing(folder, ".bin")) and not _missing(folder, ".txt")


def _missing(folder: Path, suffix: str) -> tuple[str, ...]:
    names = (stem + suffix for stem in _REQUIRED)
    return tuple(name for name in names if not (folder / name).is_file())


def models_below(folder: Path) -> list[Path]:
    """Return the model folders below a folder, the least nested first.

    Links are not followed. Hidden folders, such as leftovers of killed runs, are skipped.
    """
    found: list[Path] = []
    level, seen = [folder], 0
    for _ in range(DEPTH):
        below = []
        for parent in level:
            try:
                children = sorted(entry.path for entry in os.scandir(parent) if _is_folder(entry))
            except OSError:  # no permission to read
                continue
            below += [Path(child) for child in children[: max(MOST_FOLDERS - seen, 0)]]
            seen += len(children)
        found += [child for child in below if not missing_model_files(child)]
        level = below
    return found


def _is_folder(entry: os.DirEntry[str]) -> bool:
    return entry.is_dir(follow_symlinks=False) and not entry.name.startswith(".")


class NoteWarning(UserWarning):
    """Warning that a user should read once; a command prints it as a note."""


class RecoveryWarning(NoteWarning):
    """Warning that a model replacement, interrupted in an earlier process, was now completed."""


_records: list[list[Path]] = []


@contextmanager
def recording() -> Iterator[list[Path]]:
    """Yield a list; every path that is replaced inside the block is added to it."""
    record: list[Path] = []
    _records.append(record)
    try:
        yield record
    finally:
        _records.remove(record)


def note_replaced(path: Path) -> None:
    """Add a path to every list of :func:`recording`."""
    for record in _records:
        record.append(path)


# Paths that renaming cannot replace: streams and mount points.
#
# Output to devices, pipes and descriptors of this process is written directly. Renaming works
# neither across a mount point nor onto one.

_DESCRIPTOR = re.compile(r"/dev/(stdin|stdout|stderr|fd/\d+)|/proc/(self|thread-self|\d+)/fd/\d+")
_TABLE = Path("/proc/self/mountinfo")


def is_stream(path: str | os.PathLike[str]) -> bool:
    """Return True if a path is a device, a pipe or a descriptor such as /dev/stdout.

    The result is True even for a descriptor that is redirected to a file: replacing this file would
    lose other output in it.
    """
    if _DESCRIPTOR.fullmatch(os.path.abspath(path)):  # noqa: PTH100 (links are not followed)
        return True
    target = Path(path)
    return target.exists() and not target.is_file() and not target.is_dir()


def append(path: str | os.PathLike[str], text: str) -> None:
    """Append text to a stream."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_APPEND)
        with os.fdopen(descriptor, "w", encoding="utf-8", errors="replace") as stream:
            stream.write(text)
    except OSError as error:
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error


def mount_points() -> frozenset[Path]:
    """Return the mount points, including bind mounts and mounted files.

    Empty if the system does not list its mount points.

    Format: fifth column of proc_pid_mountinfo(5), with special characters as octal escapes.
    """
    try:
        lines = _TABLE.read_bytes().splitlines()
    except OSError:
        return frozenset()
    columns = (line.split()[4] for line in lines if len(line.split()) > 4)
    return frozenset(
        Path(os.fsdecode(re.sub(rb"\\([0-7]{3})", lambda m: bytes([int(m[1], 8)]), name)))
        for name in columns
    )
