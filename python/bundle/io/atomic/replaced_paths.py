"""Record of replaced paths, and paths that renaming cannot replace: streams and mount points.

If a command fails, its error lists the files that it had already written. This module imports
almost nothing, because the command line needs it before it has parsed its arguments.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


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
