"""Output: protection of existing files, and writing without partial files."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from bundle.base.tables import Block, is_terminal, print_styled, render, screen_width
from bundle.cli.standard_streams import print_out
from bundle.errors import InputError, shown
from bundle.io.atomic import atomic_write as atomic
from bundle.io.open import has_same_images
from bundle.io.recognition import reconstruction_at, sequence_at
from bundle.reports.sections import Report, dumps
from bundle.reports.terminal.screen import fitted, laid_out

if TYPE_CHECKING:
    from bundle.model.problem import Problem


def check_replaced(
    path: str, sources: Iterable[str], overwrite: bool, is_same: Callable[[Path], bool]
) -> None:
    """Refuse to replace a model, pose graph or sequence that is not the input.

    ``is_same`` tells whether that at a path has the same images or poses; then it may be replaced.
    """
    target = Path(path)
    if overwrite or not target.exists() or any(_is_same_file(target, source) for source in sources):
        return
    found = reconstruction_at(target) or ("a sequence" if sequence_at(target) else None)
    if found is None:
        return
    try:
        if is_same(target):
            return
    except (InputError, OSError):
        found = f"{found} that cannot be read"
    else:
        parts = "poses" if found == "a pose graph" else "images"
        found = f"{found} of other {parts}"
    raise InputError(
        f"{shown(path)}: expected no file, or the model of INPUT, found {found} (--overwrite "
        "replaces it)"
    )


def same_images(*problems: Problem) -> Callable[[Path], bool]:
    """Return a function that tells whether a model at a path has the images of these problems."""
    names = [name for problem in problems for name in problem.image_names]
    if len(problems) > 1:  # shared images count once
        names = list(dict.fromkeys(names))
    return lambda path: has_same_images(path, names)


def _is_same_file(one: Path, other: str) -> bool:
    try:
        return one.samefile(other)
    except OSError:
        return False


def check_new(path: str, flag: str) -> None:
    """Refuse to replace an existing path other than an empty folder; the flag allows it."""
    target = Path(path)
    if not os.path.lexists(target) or (target.is_dir() and next(target.iterdir(), None) is None):
        return
    found = reconstruction_at(target) or ("a folder" if target.is_dir() else "a file")
    raise InputError(f"{shown(path)}: expected a new path, found {found} ({flag} replaces it)")


class Request(Protocol):
    """Values of the flags that every command has for its report."""

    @property
    def json(self) -> str | None:
        """Path of the JSON report; "-" for standard output; None for no report."""

    @property
    def verbose(self) -> bool:
        """True to print details."""


def publish(report: Report, asked: argparse.Namespace | Request) -> None:
    """Write the page of a report; print it; write its JSON, always complete, or print that ("-").

    Reports without a title have no page of their own.
    """
    page = getattr(asked, "html", None)
    if report.title and page is not None:
        from bundle.reports.page.result_pages import write_reported  # for --html only

        write_reported(report, page)
    if asked.json != "-":
        width = screen_width(sys.stdout)
        show(*(laid_out(report, verbose=True) if asked.verbose else fitted(report, width)))
    if asked.json is not None:
        write_json(asked.json, report.json())


def write_json(path: str | None, report: dict[str, Any]) -> None:
    """Write JSON completely to a file, to standard output ("-"), or not at all (None)."""
    if path is None:
        return
    if path == "-":
        print_out(dumps(report))
    else:
        atomic.write_text(Path(path), dumps(report))


def show(*blocks: Block | str) -> None:
    """Print to standard output, in colour if it is a terminal."""
    if is_terminal(sys.stdout):
        print_styled(blocks, sys.stdout)
    else:
        print_out(render(*blocks, width=screen_width(sys.stdout)))
