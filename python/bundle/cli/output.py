"""Where reports go: checks before the work starts, and writing that leaves no halves."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from rich.console import RenderableType

from bundle.cli.standard_streams import print_out
from bundle.errors import InputError, shown
from bundle.io import atomic
from bundle.io.model_files import MODEL_FILES
from bundle.io.recognition import SEQUENCE_FILES, reconstruction_at
from bundle.io.streams import is_stream
from bundle.reports import json
from bundle.tables import console, render

__all__ = ["check_json", "check_new", "show", "write_json"]

_READ_FROM_FOLDERS = (*MODEL_FILES, *SEQUENCE_FILES)


def check_json(path: str | None, *others: str, what: str = "report") -> None:
    """Refuse now a path that a report could not be written to later, or must not be.

    Args:
        path: the argument of --json or --html.
        *others: what the command reads and writes besides, which a report must not replace.
        what: a report, or what else is written there.

    Raises:
        InputError: the path is a folder, has no folder to be in, is one of the others or a file of
            a model or sequence in one of them, or a reconstruction stands there.
        OSError: there is no permission to write.

    """
    if path is None or path == "-" or is_stream(path):
        return
    target = Path(os.path.realpath(path))
    for other in (Path(os.path.realpath(other)) for other in others):
        if target == other or (target.parent == other and target.name in _READ_FROM_FOLDERS):
            raise InputError(f"{shown(path)}: the {what} would replace what the command works on")
    atomic.check_file(Path(path))
    found = reconstruction_at(target)
    if found is not None:
        raise InputError(f"{shown(path)}: the {what} would replace {found}")


def check_new(path: str, flag: str) -> None:
    """Refuse to replace what stands at a path, an empty folder aside; the flag allows it.

    Raises:
        InputError: something stands there.
    """
    target = Path(path)
    if not os.path.lexists(target) or (target.is_dir() and next(target.iterdir(), None) is None):
        return
    found = reconstruction_at(target) or ("a folder" if target.is_dir() else "a file")
    raise InputError(f"{shown(path)}: expected nothing there, found {found} ({flag} replaces it)")


def write_json(path: str | None, report: dict[str, Any]) -> None:
    """Write a report to a file, whole or not at all, to standard output ("-"), or nowhere."""
    if path is None:
        return
    if path == "-":
        print_out(json.dumps(report))
    else:
        atomic.write_text(Path(path), json.dumps(report))


def show(*renderables: RenderableType) -> None:
    """Print to standard output, in colour if it is a terminal."""
    screen = console(sys.stdout)
    if screen.is_terminal:
        screen.print(*renderables, sep="\n", crop=False)  # a long word of a command stays whole
    else:
        print_out(render(*renderables, width=screen.width))
