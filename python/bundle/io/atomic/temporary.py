"""Temporary files and folders that are removed even after a crash, and their flushing to disk.

Each has the name ``.bundle-XXXXXXXXXXXX.tmp`` and is in the same folder as its destination. Its
process holds a lock on it (flock). The kernel releases the lock when the process ends, also after a
crash. A later run can therefore remove the temporaries of killed processes but not those of running
processes. On file systems without locks, temporaries of killed processes stay.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import stat
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from bundle.io.atomic.replaced_paths import MODEL_FILES

NEW = "new"  # inside a temporary folder: the new model; after an exchange, the old model
OLD = "old"  # inside a temporary folder: old files that were moved away one by one

_NAME = re.compile(r"\.bundle-[0-9a-f]{12}\.tmp")


class Temporary:
    """A temporary file or folder and its lock.

    Attributes:
        path: current path; updated when the folder moves.
        keep: if True, do not remove it, because it holds the only copies of some user files.
    """

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path = path
        self.keep = False
        self.descriptor = descriptor

    def move_into(self, folder: Path) -> None:
        """Move the temporary into another folder of the same file system by renaming."""
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
    """Return True if a name has the form of this package's temporary files."""
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
    """Lock an open file or folder.

    Return False if another process holds the lock, None if the file system has no locks.
    """
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
    """Return True if this path still leads to the open file."""
    try:
        return os.path.samestat(path.lstat(), os.fstat(descriptor))
    except OSError:
        return False


def holds_only_copies(path: Path) -> bool:
    """Return True if a temporary folder holds the only copies of some files and must be kept.

    Model files in ``new`` are ignored, because they are either unfinished or replaced. Other files
    in ``new`` are ignored if they are hard links to files that also exist elsewhere. All other
    content must be kept: files in ``old``, the folders of an unfinished replacement (see
    ``bundle.io.atomic.replacement``), and files that another program wrote into a folder while it
    was exchanged.
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
    """Remove a file or folder; on failure, the next run tries again."""
    with contextlib.suppress(OSError):
        if not stat.S_ISDIR(path.lstat().st_mode):
            path.unlink()
            return
        with contextlib.suppress(OSError):
            path.rmdir()  # all has been renamed
            return
        import shutil  # late: it loads three compressors

        shutil.rmtree(path / OLD, ignore_errors=True)  # first: alone it would look like data
        shutil.rmtree(path, ignore_errors=True)


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
