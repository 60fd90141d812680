"""Atomic output: a file or model appears completely or not at all.

Output is written to a temporary name ``.bundle-XXXX.tmp`` in the folder of its destination, flushed
to the disk, and only then renamed. An error before the rename (a full disk, an exception, Ctrl-C)
leaves the destination unchanged and removes the temporary files. A killed process or a power
failure leaves either the old or the new content, never a mixture:

* A file, or a folder that did not exist, appears by one rename.
* An existing folder is exchanged with the new one in one step. Before that, all files of the old
  folder except the model are linked into the new one (``bundle.io.atomic.replacement``).
* If the system cannot exchange folders, the model files are replaced one by one. After an error the
  replacement is rolled back. A killed process leaves a record; the next command that reads or
  writes there completes the replacement from it (``bundle.io.atomic.replacement``).

If two processes write to the same path, the last one wins. Missing folders above the destination
are created; an error removes them again. Symbolic links to the destination are followed. Owner and
permissions are kept as far as the system allows.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bundle.base.own_process import interrupts_deferred
from bundle.errors import InputError, shown
from bundle.io.atomic import replacement
from bundle.io.atomic.replaced_paths import (
    MODEL_FILES,
    append,
    is_stream,
    missing_model_files,
    mount_points,
    note_replaced,
)
from bundle.io.atomic.temporary import (
    NEW,
    Temporary,
    flush,
    flush_folder,
    flush_with_files,
    holds_only_copies,
    is_same,
    is_temporary,
    lock,
    remove_leftovers,
    temporary_file,
    temporary_folder,
)


def recover(path: Path) -> tuple[str, ...]:
    """Complete interrupted replacements in a folder; return one sentence for each."""
    target = Path(os.path.realpath(path))
    return replacement.recover(target) if target.is_dir() else ()


def check_file(path: Path) -> None:
    """Raise the errors that ``replace_file`` raises before anything is written.

    Raises:
        InputError: the path is a folder, a device or a pipe, or a path above it is not a folder.
        PermissionError: the file or its folder is write-protected.
    """
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise InputError(f"{shown(path)}: expected a file or a new path, found a folder")
    if is_stream(path):
        raise InputError(f"{shown(path)}: expected a file or a new path, found a device or pipe")
    _check_parent(path, target)
    if target in mount_points():
        raise InputError(
            f"{shown(path)}: expected a file that can be replaced, found a mount point"
        )
    _check_writable(path, target if target.exists() else _existing(target.parent))
    _check_writable(path, _existing(target.parent))


def check_folder(path: Path) -> None:
    """Raise the errors that ``replace_folder`` raises before anything is written.

    Raises:
        InputError: the path is a file or device, or a folder that is neither empty nor a COLMAP
            model, or a path above it is not a folder.
        PermissionError: the folder, or the parent of a new folder, is write-protected.
    """
    target = Path(os.path.realpath(path))
    if is_stream(path):
        raise InputError(
            f"{shown(path)}: expected a COLMAP model folder or a new path, found a device or pipe"
        )
    _check_parent(path, target)
    if not target.exists():
        _check_writable(path, _existing(target.parent))
        return
    if not target.is_dir():
        raise InputError(
            f"{shown(path)}: expected a COLMAP model folder or a new path, found a file"
        )
    if missing_model_files(target):
        others = sorted(file.name for file in target.iterdir() if not is_temporary(file.name))
        if others:
            raise InputError(
                f"{shown(path)}: expected a COLMAP model, an empty folder or a new path, found a "
                f"folder with other content ({shown(others[0])})"
            )
    for file in sorted(target.iterdir()):
        if file.name in MODEL_FILES and file.is_dir():
            raise InputError(f"{shown(file)}: expected a file of the model, found a folder")
    _check_writable(path, target)


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; it becomes ``path`` when the block ends without error."""
    check_file(path)
    target = Path(os.path.realpath(path))
    remove_leftovers(target.parent)
    mode = 0o600 | stat.S_IMODE(target.stat().st_mode) if target.exists() else 0o666
    with (
        _blaming(path),
        made_folder(target.parent),
        temporary_file(target.parent, mode) as temporary,
    ):
        yield temporary.path
        _take_over_file(target, temporary.path)
        flush(temporary.path)
        with interrupts_deferred():
            temporary.path.replace(target)
            note_replaced(path)
        flush_folder(target.parent)


@contextmanager
def replace_folder(path: Path) -> Iterator[Path]:
    """Yield a temporary folder for a COLMAP model; at the end its files replace those of ``path``.

    All old model files of ``path`` are removed, even those that the new model does not have. All
    other files in ``path`` stay.
    """
    check_folder(path)
    target = Path(os.path.realpath(path))
    exists = target.exists()
    for folder in (target.parent, target):
        remove_leftovers(folder)
    beside = not exists or replacement.can_exchange(target)
    with (
        _blaming(path),
        made_folder(target.parent),
        temporary_folder(target.parent if beside else target) as temporary,
    ):
        new = temporary.path / NEW
        new.mkdir()
        if exists:
            beside = replacement.take_over_folder(target, new) and beside
        yield new
        for file in new.iterdir():
            _take_over_file(target / file.name, file)
        flush_with_files(new)
        with interrupts_deferred():
            if exists or not replacement.move_new_folder(new, target):
                _replace_existing(target, temporary, beside)
            note_replaced(path)
            temporary.remove()
        flush_folder(target.parent)


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Create a folder and the missing ones above it; after an error remove those that are empty."""
    missing = []
    place = folder
    while not place.exists():
        missing.append(place)
        place = place.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for one in missing:
            flush_folder(one.parent)
        yield
    except BaseException:
        for one in missing:
            with contextlib.suppress(OSError):  # another process has written there
                one.rmdir()
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text to a file atomically, or into a device or pipe."""
    if is_stream(path):
        append(path, text)
        return
    with replace_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


def _replace_existing(target: Path, temporary: Temporary, beside: bool) -> None:
    new = temporary.path / NEW
    with _locked(target):
        if beside and replacement.exchange_folder(target, new):
            temporary.keep = holds_only_copies(temporary.path)
        else:
            replacement.replace_in_place(target, temporary)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Prevent other processes from replacing a folder at the same time."""
    while True:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            lock(descriptor)
            if is_same(folder, descriptor):  # False: exchanged during the wait
                yield
                return
        finally:
            os.close(descriptor)


def _take_over_file(old: Path, new: Path) -> None:
    """Copy owner and permissions of the replaced file, if it exists, to the new file."""
    try:
        status = old.stat()
    except OSError:
        return
    if not stat.S_ISREG(status.st_mode):
        return
    with contextlib.suppress(OSError):  # only root may change owners
        os.chown(new, status.st_uid, status.st_gid)
    new.chmod(stat.S_IMODE(status.st_mode))


def _check_parent(path: Path, target: Path) -> None:
    place = _existing(target.parent)
    if not place.is_dir():
        raise InputError(
            f"{shown(path)}: expected a folder {shown(place)} to write into, found a file or pipe"
        )


def _existing(folder: Path) -> Path:
    """Return the nearest path above that exists, or the folder itself."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder


def _check_writable(path: Path, target: Path) -> None:
    if not os.access(target, os.W_OK):
        raise PermissionError(13, f"{shown(target)} is not writable", shown(path))


@contextmanager
def _blaming(path: Path) -> Iterator[None]:
    """Replace the temporary path in system errors by the user's path."""
    try:
        yield
    except OSError as error:
        name = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else None
        ours = name is None or any(is_temporary(part) for part in Path(name).parts)
        if error.errno is None or not ours:
            raise
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error
