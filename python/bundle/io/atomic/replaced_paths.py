"""Record of the paths that were replaced, and warnings that a user should read.

If a command fails, its error lists the files that it had already written. This module imports
almost nothing, because the command line needs it before it has parsed its arguments.
"""

from __future__ import annotations

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
