"""Waiting until files are on the disk."""

from __future__ import annotations

import contextlib
import os
import threading
from pathlib import Path

__all__ = ["flush", "flush_folder", "flush_with_files"]


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


def flush_with_files(folder: Path) -> None:
    """Wait until a folder and the few files in it are on the disk.

    All are flushed at the same time: a file system with a journal then commits once or twice, not
    once per file, and each commit waits for the disk.

    Raises:
        OSError: of the first file by name that could not be flushed, after all have been tried.
    """
    files = sorted(folder.iterdir())
    failures: dict[Path, OSError] = {}

    def attempt(file: Path) -> None:
        try:
            flush(file)
        except OSError as error:
            failures[file] = error

    threads: list[threading.Thread] = []
    for file in files:
        thread = threading.Thread(target=attempt, args=(file,))
        try:
            thread.start()
        except RuntimeError:  # the system has no more threads
            attempt(file)
        else:
            threads.append(thread)
    flush_folder(folder)
    for thread in threads:
        thread.join()
    for file in files:
        if file in failures:
            raise failures[file]
