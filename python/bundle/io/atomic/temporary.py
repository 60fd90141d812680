"""Temporary files and folders that are removed even after a crash.

Each has the name ``.bundle-XXXXXXXXXXXX.tmp`` and stands beside its destination. Its process holds
a lock on it (flock), which the kernel releases when the process ends in any way. A later run can
therefore remove the leftovers of killed processes and leave the temporaries of running ones alone.
On file systems without locks, leftovers stay.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from bundle.io.atomic.model_files import MODEL_FILES

__all__ = [
    "NEW",
    "OLD",
    "Temporary",
    "holds_only_copies",
    "is_same",
    "is_temporary",
    "lock",
    "remove_leftovers",
    "temporaries_in",
    "temporary_file",
    "temporary_folder",
]

NEW = "new"  # inside a temporary folder: the model that is written, after an exchange the old one
OLD = "old"  # inside a temporary folder: old files that were moved out of the way one by one

_NAME = re.compile(r"\.bundle-[0-9a-f]{12}\.tmp")


class Temporary:
    """A temporary file or folder and its lock.

    Attributes:
        path: current path, also after a move of the folder.
        keep: do not remove it: it holds files of the user that exist nowhere else.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self.keep = False
        self.descriptor = descriptor

    def move_into(self, folder: Path) -> None:
        """Rename it into another folder of the same file system."""
        moved = folder / self.path.name
        self.path.rename(moved)
        self.path = moved

    def remove(self) -> None:
        """Remove the remaining files, unless they must be kept, and release the lock."""
        if self.descriptor < 0:
            return
        if not self.keep and is_same(self.path, self.descriptor):
            _remove(self.path)
        os.close(self.descriptor)
        self.descriptor = -1


def is_temporary(name: str) -> bool:
    """Tell whether a name is that of a temporary of this package."""
    return _NAME.fullmatch(name) is not None


def temporaries_in(folder: Path) -> list[Path]:
    """Return the temporaries in a folder, sorted; empty if it cannot be read."""
    with contextlib.suppress(OSError):
        return sorted(file for file in folder.iterdir() if is_temporary(file.name))
    return []


@contextmanager
def temporary_file(folder: Path, mode: int) -> Iterator[Temporary]:
    """Yield a new empty file, which is removed at the end unless it was renamed."""
    flags = os.O_RDWR | os.O_CREAT | os.O_EXCL

    def make(path: Path) -> None:
        os.close(os.open(path, flags, mode))

    with _made(folder, make, os.O_RDWR) as temporary:
        yield temporary


@contextmanager
def temporary_folder(folder: Path) -> Iterator[Temporary]:
    """Yield a new empty folder that only its owner may enter; it is removed at the end."""
    with _made(folder, lambda path: path.mkdir(0o700), os.O_RDONLY) as temporary:
        yield temporary


@contextmanager
def _made(folder: Path, make: Callable[[Path], None], flags: int) -> Iterator[Temporary]:
    while True:
        path = folder / f".bundle-{os.urandom(6).hex()}.tmp"
        make(path)
        try:
            temporary = Temporary(path, os.open(path, flags))
        except FileNotFoundError:
            continue  # another process removed it as a leftover
        try:
            lock(temporary.descriptor)
            if is_same(path, temporary.descriptor):  # else as above
                yield temporary
                return
        finally:
            temporary.remove()


def lock(descriptor: int, *, wait: bool = True) -> bool | None:
    """Lock an open file or folder. Return False if another process holds it, None without locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        return False if error.errno in (errno.EWOULDBLOCK, errno.EAGAIN) else None
    return True


def remove_leftovers(folder: Path) -> None:
    """Remove temporaries of killed processes from a folder, unless a user's file would be lost."""
    for path in temporaries_in(folder):
        with contextlib.suppress(OSError):
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
            try:
                if os.fstat(descriptor).st_uid != os.geteuid():
                    continue
                free = lock(descriptor, wait=False)
                if free and is_same(path, descriptor) and not holds_only_copies(path):
                    _remove(path)
            finally:
                os.close(descriptor)


def is_same(path: Path, descriptor: int) -> bool:
    """Tell whether an open file is still the one at this path."""
    try:
        return os.path.samestat(path.lstat(), os.fstat(descriptor))
    except OSError:
        return False


def holds_only_copies(path: Path) -> bool:
    """Tell whether all files of a temporary folder are unfinished or replaced, or links to others.

    Model files in ``new`` were never finished, or have been replaced. Other files there are further
    links to files in place. Anything else must stay: ``old`` and the phases of an unfinished
    replacement (see ``bundle.io.atomic.in_place``), and files that another program wrote into a
    folder while it was exchanged.
    """
    if not stat.S_ISDIR(path.lstat().st_mode):
        return False
    for child in path.iterdir():
        if child.name != NEW and not (child.name == OLD and next(child.iterdir(), None) is None):
            return True
    for folder, _, names in os.walk(path / NEW):
        for name in names:
            if Path(folder) == path / NEW and name in MODEL_FILES:
                continue
            if (Path(folder) / name).lstat().st_nlink == 1:
                return True
    return False


def _remove(path: Path) -> None:
    """Remove a file or folder; if that fails, it is left to the next run."""
    with contextlib.suppress(OSError):
        if not stat.S_ISDIR(path.lstat().st_mode):
            path.unlink()
            return
        shutil.rmtree(path / OLD, ignore_errors=True)  # first: alone it would look like data
        shutil.rmtree(path, ignore_errors=True)
