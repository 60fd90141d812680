"""Where results go: checks before the work starts, and writing that leaves no halves."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from rich.console import RenderableType

from bundle.errors import InputError
from bundle.report import json as report
from bundle.report.text import console, render

__all__ = ["check_destination", "check_json", "output_format", "show", "write_json"]

BAL_NAMES = (".txt", ".txt.gz", ".txt.bz2")


def output_format(path: str, requested: str | None, input_format: str) -> str:
    """Return the format that a problem is written in: as asked, as named, or as it was read."""
    if requested is not None:
        return requested
    if path.lower().endswith(BAL_NAMES) and not Path(path).is_dir():
        return "bal"
    folder = path.endswith(os.sep) or Path(path).is_dir()
    return "colmap" if folder else input_format


def check_destination(path: str, kind: str) -> None:
    """Refuse a path that a model of this format cannot be written to.

    Raises:
        InputError: there is no such folder to write in, it may not be written in, or something of
            another kind stands there.

    """
    target = Path(path)
    if kind == "bal":
        if target.is_dir():
            raise InputError(f"{path}: expected a file to write, found a folder")
        if target.exists() and not target.is_file():
            raise InputError(f"{path}: expected a file to write, found a device")
    elif target.exists() and not target.is_dir():
        raise InputError(f"{path}: expected a folder to write, found a file")
    _check_parent(path)


def check_json(path: str | None) -> None:
    """Refuse a path that a report cannot be written to."""
    if path is None or path == "-":
        return
    if Path(path).is_dir():
        raise InputError(f"{path}: expected a file to write, found a folder")
    _check_parent(path)


def write_json(path: str | None, content: dict[str, Any]) -> None:
    """Write a report to a file, whole or not at all, to standard output ("-"), or nowhere."""
    if path is None:
        return
    text = report.dumps(content)
    if path == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    target = Path(path).resolve()
    if target.exists() and not target.is_file():  # a pipe or a device: there is nothing to keep
        target.write_text(text, encoding="ascii")
        return
    partial = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        partial.write_text(text, encoding="ascii")
        partial.replace(target)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, path) from None


def show(*renderables: RenderableType) -> None:
    """Print to standard output, as long as somebody reads it.

    A reader that has seen enough (`| head`) is no failure of the work that was done.
    """
    try:
        screen = console(sys.stdout)
        if screen.is_terminal:
            screen.print(*renderables, sep="\n")
        else:
            sys.stdout.write(render(*renderables))
        sys.stdout.flush()
    except BrokenPipeError:
        # The interpreter flushes once more at its exit, which must not complain either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _check_parent(path: str) -> None:
    if not path:
        raise InputError("expected a path to write to, found an empty one")
    folder = Path(path).parent
    if not folder.is_dir():
        raise InputError(f"{path}: there is no folder {str(folder)!r} to write in")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{path}: no permission to write in {str(folder)!r}")
