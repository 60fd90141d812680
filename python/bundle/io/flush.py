"""Waiting until files are on the disk."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

__all__ = ["flush", "flush_folder"]


def flush(path: Path) -> None:
    """Wait until a file is on the disk; a full disk may show only here."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def flush_folder(folder: Path) -> None:
    """Wait until names are on the disk, where the file system can tell."""
    with contextlib.suppress(OSError):
        flush(folder)
