"""Where reports go: checks before the work starts, and writing that leaves no halves."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path
from typing import Any

from rich.console import RenderableType

from bundle.errors import InputError, shown
from bundle.io import atomic
from bundle.report import json
from bundle.tables import console, render

__all__ = ["check_json", "show", "write_json"]


def check_json(path: str | None, *others: str) -> None:
    """Refuse now a path that a report could not be written to later.

    Args:
        path: the argument of --json.
        *others: what the command reads and writes besides, which a report must not replace.

    Raises:
        InputError: the path is a folder, has no folder to be in, or is one of the others.
        OSError: there is no permission to write.

    """
    if path is None or path == "-":
        return
    target = os.path.realpath(path)
    if any(target == os.path.realpath(other) for other in others):
        raise InputError(f"{shown(path)}: the report would replace what the command works on")
    if not _is_device(path):
        atomic.check_file(Path(path))


def write_json(path: str | None, report: dict[str, Any]) -> None:
    """Write a report to a file, whole or not at all, to standard output ("-"), or nowhere."""
    if path is None:
        return
    text = json.dumps(report)
    if path == "-":
        _print(text)
    elif _is_device(path):
        Path(path).write_text(text, encoding="ascii")
    else:
        with atomic.replace_file(Path(path)) as temporary:
            temporary.write_text(text, encoding="ascii")


def show(*renderables: RenderableType) -> None:
    """Print to standard output, in colour if it is a terminal."""
    screen = console(sys.stdout)
    if screen.is_terminal:
        screen.print(*renderables, sep="\n")
    else:
        _print(render(*renderables, width=screen.width))


def _print(text: str) -> None:
    """Print as long as somebody reads: `| head` is no failure of the work that was done."""
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.write(text)
        sys.stdout.flush()


def _is_device(path: str) -> bool:
    """Whether something stands at path that is written into, not replaced: a pipe, a device."""
    target = Path(path)
    return target.exists() and not target.is_file() and not target.is_dir()
