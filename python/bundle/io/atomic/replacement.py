"""Replacing a folder in one step, or its files one by one where the system cannot."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import functools
import os
import stat
import sys
import time
from collections.abc import Callable
from pathlib import Path

from bundle.errors import InputError, shown
from bundle.io.atomic.replaced_paths import MODEL_FILES, mount_points
from bundle.io.atomic.temporary import (
    NEW,
    OLD,
    Temporary,
    flush_folder,
    is_temporary,
    lock,
    temporaries_in,
)

# Replacing a folder in one step: the new folder and the old one exchange their names.
#
# Linux can exchange two names atomically (renameat2 with RENAME_EXCHANGE). Only the model files
# must change. The new folder therefore first gets hard links to all other files of the old folder,
# including subfolders. At any time the path leads to either the complete old or the complete new
# folder.
#
# Requirements: a writable parent folder on the same file system, and hard links. The working
# directory and its parents are not exchanged, because the shell would stay in the old folder.
# Folders that contain a mount point are not exchanged either.

MAX_LINKS = 20_000
"""Largest number of non-model files to link. Linking more would take seconds."""

_AT_FDCWD = -100
_RENAME_EXCHANGE = 2


def can_exchange(target: Path) -> bool:
    """Return False if a folder cannot be exchanged; True if an attempt may succeed."""
    parent = target.parent
    if parent == target or not os.access(parent, os.W_OK | os.X_OK):
        return False
    if parent.stat().st_dev != target.stat().st_dev:
        return False
    if any(target in (point, *point.parents) for point in mount_points()):
        return False
    try:
        current = Path.cwd()
    except OSError:
        return True
    return current != target and target not in current.parents


def take_over_folder(old: Path, new: Path) -> bool:
    """Copy owner, permissions and attributes to a new folder; return False on failure."""
    import shutil  # late: it loads three compressors

    status, mine = old.stat(), new.stat()
    try:
        if (status.st_uid, status.st_gid) != (mine.st_uid, mine.st_gid):
            os.chown(new, status.st_uid, status.st_gid)
        shutil.copystat(old, new)
        os.utime(new)
    except OSError:
        return False
    return stat.S_IMODE(new.stat().st_mode) == stat.S_IMODE(status.st_mode)


def move_new_folder(new: Path, target: Path) -> bool:
    """Rename a folder to an unused name; return False if another process has created that name."""
    try:
        new.rename(target)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
            return False
        raise
    return True


def exchange_folder(target: Path, new: Path) -> bool:
    """Link all non-model files of ``target`` into ``new``, then exchange the two folders.

    Afterwards ``new`` is the old folder and can be removed.

    Returns:
        False if the system cannot exchange; then ``new`` is unchanged.
    """
    linked: dict[str, tuple[int, int]] = {}
    try:
        _link(target, new, "", linked)
        for folder, _, _ in os.walk(new):
            flush_folder(Path(folder))
        _exchange(new, target)
    except OSError:
        _unlink(new)
        return False
    except BaseException:
        _unlink(new)
        raise
    _bring_latecomers(new, target, "", linked)
    return True


def _link(source: Path, copy: Path, below: str, linked: dict[str, tuple[int, int]]) -> None:
    """Link the content of source into copy, folder by folder, and record the files."""
    for entry in sorted(os.scandir(source / below), key=lambda entry: entry.name):
        if not below and entry.name in MODEL_FILES:
            continue
        if not below and is_temporary(entry.name):
            raise OSError(errno.EBUSY, "another process is at work in this folder")
        name = f"{below}/{entry.name}" if below else entry.name
        status = entry.stat(follow_symlinks=False)
        linked[name] = (status.st_dev, status.st_ino)
        if len(linked) > MAX_LINKS:
            raise OSError(errno.EMLINK, "too many files to link")
        if not entry.is_dir(follow_symlinks=False):
            os.link(entry.path, copy / name, follow_symlinks=False)
            continue
        if not os.access(entry.path, os.W_OK):
            raise OSError(errno.EPERM, "a folder below this one cannot be removed")
        (copy / name).mkdir()
        _link(source, copy, name, linked)
        if not take_over_folder(Path(entry.path), copy / name):
            raise OSError(errno.EPERM, "a folder below this one has another owner")
        os.utime(copy / name, ns=(status.st_atime_ns, status.st_mtime_ns))


def _unlink(new: Path) -> None:
    """Remove the links from a new folder."""
    for entry in os.scandir(new):
        if entry.is_dir(follow_symlinks=False):
            import shutil  # late, as above

            shutil.rmtree(entry.path, ignore_errors=True)
        elif entry.name not in MODEL_FILES:
            Path(entry.path).unlink()


def _bring_latecomers(
    old: Path, target: Path, below: str, linked: dict[str, tuple[int, int]]
) -> None:
    """Move files that another program created in the old folder after its files were linked."""
    for entry in list(os.scandir(old / below)):
        if not below and entry.name in MODEL_FILES:
            continue
        name = f"{below}/{entry.name}" if below else entry.name
        status = entry.stat(follow_symlinks=False)
        if linked.get(name) != (status.st_dev, status.st_ino):
            with contextlib.suppress(OSError):  # see temporary.holds_only_copies
                Path(entry.path).replace(target / name)
        elif entry.is_dir(follow_symlinks=False):
            _bring_latecomers(old, target, name, linked)


def _exchange(first: Path, second: Path) -> None:
    """Exchange two names in one step."""
    rename = _renameat2()
    if rename is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    sys.audit("bundle.exchange", os.fspath(first), os.fspath(second))
    if rename(_AT_FDCWD, os.fsencode(first), _AT_FDCWD, os.fsencode(second), _RENAME_EXCHANGE):
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))


@functools.cache
def _renameat2() -> Callable[..., int] | None:
    """Return the C library's renameat2 (since glibc 2.28, musl 1.2.4), or None."""
    try:
        function = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return None
    function.argtypes = [
        ctypes.c_int,
        ctypes.c_char_p,
        ctypes.c_int,
        ctypes.c_char_p,
        ctypes.c_uint,
    ]
    function.restype = ctypes.c_int
    rename: Callable[..., int] = function
    return rename


# Replacement of model files one by one, for systems that cannot exchange folders.
#
# The temporary folder is inside the target folder and also records the progress. Its subfolders
# name the phase of the replacement:
#
# ========= =====================================================================================
# new       new files are being written; old files are in place; the folder may be removed
# whole     the new files are complete on the disk; the old ones are being moved to ``old``
# entering  all old files are in ``old``; the new ones are being moved into the target
# ========= =====================================================================================
#
# A process that is killed in the last two phases leaves a folder that no program can load. However,
# all files exist and the phase identifies them. ``recover`` completes the replacement from any
# state.

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
    """Complete interrupted replacements in a folder; return one sentence for each."""
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
