"""Paths from users, lines of text files, the cache folder, and the path of the C++ headers."""

from __future__ import annotations

import codecs
import os
from pathlib import Path
from typing import Any, TypeGuard

from bundle.errors import InputError, brief, shown

UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def as_path(path: Any, name: str = "path") -> Path:
    """Convert a path to a ``pathlib.Path``."""
    if not is_path(path):
        raise InputError(f"{name}: expected a path, found {brief(path)}")
    text = os.fspath(path)
    if text == "":
        raise InputError(f"{name}: expected a path, found an empty string")
    try:
        valid = b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        valid = False
    if not valid:
        raise InputError(
            f"{name}: expected a path that this system can encode, found {brief(text)}"
        )
    return Path(text)


def is_path(value: Any) -> TypeGuard[str | os.PathLike[str]]:
    """Return True if a value has the type of a path; False for bytes."""
    return isinstance(value, str) or (
        isinstance(value, os.PathLike) and isinstance(os.fspath(value), str)
    )


def compression_of(path: Path) -> str:
    """Return the compression that a name asks for: "gzip", "bzip2" or ""."""
    return {".gz": "gzip", ".bz2": "bzip2"}.get(path.suffix.lower(), "")


def numbered_lines(path: str | os.PathLike[str]) -> list[tuple[int, str]]:
    """Return the lines of a text file with their numbers from 1.

    Byte order marks, UTF-16 and the line ends of all systems are supported.
    """
    content = Path(path).read_bytes()
    try:
        text = content.decode("utf-16" if content.startswith(UTF16) else "utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(
            f"{shown(path)}: expected text in UTF-8, found bytes that are not UTF-8"
        ) from None
    return list(enumerate(text.replace("\ufeff", "").split("\n"), 1))


def get_include() -> str:
    """Return the include folder with which a compiler finds ``#include <bundle/check.h>``.

    This header checks Ceres cost functions in C++ tests. With ``bundle/checkable.h``,
    ``bundle.check_gradients`` checks them in Python.
    """
    return str(Path(__file__).resolve().parents[1] / "include")


def cache_folder() -> Path:
    """Return the folder, which may not exist."""
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():  # required by the XDG specification
        base = Path.home() / ".cache"
    return base / "bundle"


def write_cached(path: Path, text: str) -> None:
    """Replace a file of the folder in one step; only its user can read it."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    partial = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(text)
        partial.replace(path)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
