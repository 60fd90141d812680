"""Flushing of files and folders to the disk (fsync)."""

from __future__ import annotations

import contextlib
import os
import threading
from pathlib import Path


def flush(path: Path) -> None:
    """Wait until a file is on the disk; the error of a full disk may appear only here."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def flush_folder(folder: Path) -> None:
    """Wait until the entries of a folder are on the disk, if the file system supports it."""
    with contextlib.suppress(OSError):
        flush(folder)


def flush_with_files(folder: Path) -> None:
    """Wait until a folder and the few files in it are on the disk.

    The files are flushed in parallel, because each commit of a journaling file system waits for the
    disk. With parallel calls it commits once or twice instead of once per file.

    Raises:
        OSError: a file could not be flushed. All files are tried; the error of the first by name
            is raised.
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
