"""Replacement of model files one by one, for systems that cannot exchange folders.

The temporary folder is inside the target folder and also records the progress. Its subfolders name
the phase of the replacement:

========= =====================================================================================
new       new files are being written; old files are in place; the folder may be removed
whole     the new files are complete on the disk; the old ones are being moved to ``old``
entering  all old files are in ``old``; the new ones are being moved into the target
========= =====================================================================================

A process that is killed in the last two phases leaves a folder that no program can load. However,
all files exist and the phase identifies them. ``recover`` completes the replacement from any state.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

from bundle.errors import InputError, shown
from bundle.io.atomic.flush import flush_folder
from bundle.io.atomic.model_files import MODEL_FILES
from bundle.io.atomic.temporary import NEW, OLD, Temporary, lock, temporaries_in

WHOLE = "whole"
ENTERING = "entering"

PATIENCE = 10.0  # seconds to wait for another process that is replacing the files


def replace_in_place(target: Path, temporary: Temporary) -> None:
    """Replace the model files of ``target`` by those in ``new`` of a temporary folder.

    After an error the replacement is rolled back. If that fails too, the record stays for
    ``recover``.
    """
    if temporary.path.parent != target:
        temporary.move_into(target)
    folder = temporary.path
    (folder / OLD).mkdir()
    done: list[tuple[Path, Path]] = []
    temporary.keep = True
    try:
        _rename(folder / NEW, folder / WHOLE, done)
        _finish(target, folder, done)
    except BaseException:
        for source, destination in reversed(done):
            if not os.path.lexists(source):
                destination.rename(source)
        temporary.keep = False
        raise
    temporary.keep = False


def recover(target: Path) -> tuple[str, ...]:
    """Complete interrupted replacements in a folder; return one sentence for each.

    Raises:
        InputError: a replacement cannot be completed; the error names the folders with the files.
    """
    return tuple(
        f"{shown(target)}: finished the replacement of this model that a killed run had begun"
        for folder in temporaries_in(target)
        if _is_begun(folder) and _recover(target, folder)
    )


def _recover(target: Path, folder: Path) -> bool:
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_NOFOLLOW)
        try:
            if not _wait_for(descriptor) or not _is_begun(folder):
                return False  # a running process is replacing the files, or has just finished
            _finish(target, folder, [])
            Temporary(folder, os.dup(descriptor)).remove()
        finally:
            os.close(descriptor)
    except FileNotFoundError:
        if _is_begun(folder):
            raise
        return False
    except OSError as error:
        raise InputError(
            f"{shown(target)}: a killed run has replaced this model in part, and finishing that "
            f"failed ({error.strerror}); its old files are in {shown(folder / OLD)}, its new ones "
            f"in {shown(folder)}"
        ) from None
    return True


def _is_begun(folder: Path) -> bool:
    return (folder / WHOLE).is_dir() or (folder / ENTERING).is_dir()


def _wait_for(descriptor: int) -> bool:
    """Wait until no other process holds the lock; if locks are not supported, return at once."""
    deadline = time.monotonic() + PATIENCE
    while lock(descriptor, wait=False) is False:
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def _finish(target: Path, folder: Path, done: list[tuple[Path, Path]]) -> None:
    whole, entering, old = folder / WHOLE, folder / ENTERING, folder / OLD
    if whole.is_dir():
        flush_folder(folder)
        for file in sorted(target.iterdir()):
            if file.name in MODEL_FILES:
                _rename(file, old / file.name, done)
        for changed in (old, target):
            flush_folder(changed)
        _rename(whole, entering, done)
        flush_folder(folder)
    for file in sorted(entering.iterdir()):
        _rename(file, target / file.name, done)
    flush_folder(target)


def _rename(source: Path, destination: Path, done: list[tuple[Path, Path]]) -> None:
    """Record a rename, then perform it: an interruption may come right after it."""
    done.append((source, destination))
    source.rename(destination)
