"""Output that appears whole or not at all.

Everything is written beside its destination under a name ``.bundle-XXXX.tmp``, flushed to the disk,
and only then renamed into place. Whatever goes wrong before or during the renaming (a full disk, an
exception, Ctrl-C) leaves what stood at the destination as it was and removes the temporary files.

* A file, and a folder that did not exist, appear by a single rename: also a killed process or a
  power failure leaves the old or the new, never a mixture, and at worst a stale temporary file.
* In a folder that exists only the model files are exchanged, one rename each; nothing else in it
  is touched, not even for a moment. An error half-way is rolled back. Only a process killed between
  the first and the last of these few renames can leave a mixture; the old files then are whole in
  ``.bundle-XXXX.tmp/old`` inside the folder.

Symbolic links to the destination are followed, so a link stays a link.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bundle.errors import InputError, shown
from bundle.io.model_files import MODEL_FILES, missing_model_files

__all__ = ["check_file", "check_folder", "replace_file", "replace_folder"]


def check_file(path: Path) -> None:
    """Raise what ``replace_file`` would raise before it lets anything be written.

    Raises:
        InputError: the path is a folder, a device or a pipe, or its parent folder does not exist.
        PermissionError: the file is write-protected, or its folder is.
    """
    target = Path(os.path.realpath(path))
    _check_parent(path, target)
    if target.is_dir():
        raise InputError(f"{shown(path)}: expected a file or nothing, found a folder")
    if target.exists() and not target.is_file():
        raise InputError(f"{shown(path)}: expected a file or nothing, found a device or pipe")
    _check_writable(path, target if target.exists() else target.parent)
    _check_writable(path, target.parent)


def check_folder(path: Path) -> None:
    """Raise what ``replace_folder`` would raise before it lets anything be written.

    Raises:
        InputError: the path is a file, or a folder that is neither empty nor a COLMAP model, or its
            parent folder does not exist.
        PermissionError: the folder is write-protected, or the parent of a new one is.
    """
    target = Path(os.path.realpath(path))
    _check_parent(path, target)
    if not target.exists():
        _check_writable(path, target.parent)
        return
    if not target.is_dir():
        raise InputError(f"{shown(path)}: expected a COLMAP model folder or nothing, found a file")
    if missing_model_files(target):
        other = next(target.iterdir(), None)
        if other is not None:
            raise InputError(
                f"{shown(path)}: expected a COLMAP model, an empty folder or nothing, "
                f"found a folder with other content ({shown(other.name)})"
            )
    _check_writable(path, target)


@contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to; on leaving without an error it becomes ``path``.

    Raises:
        InputError: see ``check_file``.
        OSError: the system refuses; it names ``path``, not the temporary file.
    """
    check_file(path)
    target = Path(os.path.realpath(path))
    temporary = _temporary_in(target.parent)
    with _blaming(path, temporary):
        try:
            os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
            yield temporary
            if target.exists():
                temporary.chmod(stat.S_IMODE(target.stat().st_mode))
            _flush(temporary)
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
    _flush_folder(target.parent)


@contextmanager
def replace_folder(path: Path) -> Iterator[Path]:
    """Give a temporary folder to write a COLMAP model to; on leaving it becomes that of ``path``.

    Model files that stood in ``path`` are removed even if the new model has none of that name;
    everything else in ``path`` stays.

    Raises:
        InputError: see ``check_folder``.
        OSError: the system refuses; it names ``path``, not the temporary folder.
    """
    check_folder(path)
    target = Path(os.path.realpath(path))
    exists = target.exists()
    temporary = _temporary_in(target if exists else target.parent)
    new, old = temporary / "new", temporary / "old"
    with _blaming(path, temporary):
        try:
            for folder in (temporary, new, old):
                folder.mkdir()
            yield new
            for file in new.iterdir():
                _flush(file)
            _flush_folder(new)
            if exists:
                _exchange(target, new, old)
            else:
                new.rename(target)
        except BaseException:
            if not any(old.glob("*")):  # else rolling back has failed: these are the only copies
                shutil.rmtree(temporary, ignore_errors=True)
            raise
        shutil.rmtree(temporary, ignore_errors=True)
    _flush_folder(target if exists else target.parent)


def _exchange(target: Path, new: Path, old: Path) -> None:
    """Move the model files of ``target`` to ``old`` and everything in ``new`` to ``target``."""
    leaving = [(file, old / file.name) for file in target.iterdir() if file.name in MODEL_FILES]
    coming = [(file, target / file.name) for file in new.iterdir()]
    begun: list[tuple[Path, Path]] = []
    try:
        for source, destination in leaving + coming:
            begun.append((source, destination))
            source.rename(destination)
    except BaseException:
        for source, destination in reversed(begun):
            if not os.path.lexists(source):
                destination.rename(source)
        raise


def _temporary_in(folder: Path) -> Path:
    return folder / f".bundle-{secrets.token_hex(6)}.tmp"


def _check_parent(path: Path, target: Path) -> None:
    if not target.parent.is_dir():
        raise InputError(
            f"{shown(path)}: expected a folder {shown(target.parent)} to write into, found none"
        )


def _check_writable(path: Path, target: Path) -> None:
    if not os.access(target, os.W_OK):
        raise PermissionError(13, f"{shown(target)} is not writable", shown(path))


def _flush(path: Path) -> None:
    """Wait until a file is on the disk; a full disk may show only here."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flush_folder(folder: Path) -> None:
    """Wait until names are on the disk, where the file system can tell."""
    with contextlib.suppress(OSError):
        _flush(folder)


@contextmanager
def _blaming(path: Path, temporary: Path) -> Iterator[None]:
    """Let system errors about the temporary name the path that the user gave."""
    try:
        yield
    except OSError as error:
        if error.errno is None or not str(error.filename or temporary).startswith(str(temporary)):
            raise
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error
