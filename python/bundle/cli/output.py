"""Output: protection of existing files, reports, and progress.

Progress on standard error is one updating line on a terminal, and plain lines elsewhere.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from bundle.base.tables import Block, is_terminal, print_styled, render, screen_width, terminal
from bundle.cli.error_lines import print_out
from bundle.errors import InputError, shown
from bundle.io.atomic import atomic_write as atomic
from bundle.io.open import has_same_images
from bundle.io.recognition import reconstruction_at, sequence_at
from bundle.reports.sections import Report, Section, dumps
from bundle.reports.terminal.screen import fitted, laid_out

if TYPE_CHECKING:
    from rich.live import Live
    from rich.text import Text

    from bundle.model.problem import Problem


def check_replaced(
    path: str, sources: Iterable[str], overwrite: bool, is_same: Callable[[Path], bool]
) -> None:
    """Refuse to replace a model, pose graph or sequence that is not the input.

    An existing output may be replaced if ``is_same`` of its path is true: same images or poses.
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
    """Return a predicate: True if the model at a path has the images of these problems."""
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


def publish(report: Report, asked: argparse.Namespace) -> None:
    """Write the page of a report, if asked; print the report, or its JSON ("-"); write its JSON.

    Reports without a title have no page of their own.
    """
    page, config = (getattr(asked, name, None) for name in ("html", "config"))
    if config is not None:
        section = Section(facts=[("config", config.fact)])
        data = {**report.data, "config": config._asdict()}
        report = dataclasses.replace(report, sections=[*report.sections, section], data=data)
    if report.title and page is not None:
        from bundle.reports.page.result_pages import write_reported  # for --html only

        write_reported(report, page)
    if asked.json == "-":
        print_out(dumps(report.json()))
        return
    width = screen_width(sys.stdout)
    show(*(laid_out(report, verbose=True) if asked.verbose else fitted(report, width)))
    if asked.json is not None:
        atomic.write_text(Path(asked.json), dumps(report.json()))


def show(*blocks: Block | str) -> None:
    """Print to standard output, in colour if it is a terminal."""
    if is_terminal(sys.stdout):
        print_styled(blocks, sys.stdout)
    else:
        print_out(render(*blocks, width=screen_width(sys.stdout)))


_HEAD = (
    f"{'iteration':>9}  {'cost':>12}  {'change':>9}  {'gradient':>9}  {'radius':>9}  {'elapsed':>9}"
)
# Interval between lines if the output cannot update a line.
_SECONDS_BETWEEN_LINES = 10.0


class Progress:
    """Progress display of a command.

    It is used as a context manager. `stage` announces the next stage; `iteration` takes Ceres'
    IterationSummary. A write error (a closed pipe) ends the display, not the command.
    """

    def __init__(self, *, quiet: bool) -> None:
        self._started = time.perf_counter()
        self._stage, self._done = "", ""
        self._said = self._started
        self._latest: Mapping[str, Any] | None = None
        self._quiet = quiet
        self._live: Live | None = None
        if quiet or not is_terminal(sys.stderr):
            return
        screen = terminal(sys.stderr)
        if not screen.is_dumb_terminal:
            from rich.live import Live

            self._live = Live(
                console=screen,
                get_renderable=self._line,
                refresh_per_second=8,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        if self._live is not None:
            self._live.stop()

    @property
    def is_live(self) -> bool:
        """True if the line updates in place; short stages are then displayed as well."""
        return self._live is not None

    def stage(self, name: str) -> None:
        """Begin a stage, such as "reading sparse/0"."""
        self._stage, self._latest, self._done = name, None, ""
        self._said = time.perf_counter()
        self._print(f"{name} ...")

    def share(self, done: float) -> None:
        """Display the finished share of a stage, 0 to 1; only now and then in a file."""
        self._show(f"{done:.0%}")

    def text(self, num_bytes: int) -> None:
        """Display the number of bytes of text read or written."""
        self._show(f"{num_bytes / 1e9:.1f} GB")

    def _show(self, done: str) -> None:
        self._done = done
        now = time.perf_counter()
        if now - self._said >= _SECONDS_BETWEEN_LINES:
            self._said = now
            self._print(f"{self._stage} ... {done}, {self._elapsed()}")

    def iteration(self, values: Mapping[str, Any]) -> None:
        """Display an iteration; `values` has the names of Ceres' IterationSummary."""
        if self._latest is None:
            self._print(_HEAD)
        self._latest = dict(values)
        self._print(
            f"{values['iteration']:9d}  {values['cost']:12.6e}  {values['cost_change']:9.2e}  "
            f"{values['gradient_max_norm']:9.2e}  {values['trust_region_radius']:9.2e}  "
            f"{self._elapsed():>9}"
        )

    def _print(self, line: str) -> None:
        if self._live is not None:
            self._live.start()  # once; before the first stage, errors are printed without it
        if self._quiet or self._live is not None:
            return
        try:
            print(line, file=sys.stderr, flush=True)
        except OSError:
            self._quiet = True

    def _line(self) -> Text:
        """Return the updating line; at most 80 columns while it displays an iteration."""
        from rich.text import Text

        latest = self._latest
        line = Text(no_wrap=True, overflow="ellipsis")
        line.append(f"{self._elapsed():>7}  ", style="dim")
        if latest is None:
            return line.append(f"{self._stage} ... {self._done}".rstrip())
        line.append(f"iter {latest['iteration']}", style="bold")
        line.append(f"  cost {latest['cost']:.4e}  change {latest['cost_change']:.0e}")
        line.append(f"  gradient {latest['gradient_max_norm']:.0e}")
        return line.append(f"  radius {latest['trust_region_radius']:.0e}")

    def _elapsed(self) -> str:
        elapsed = time.perf_counter() - self._started
        if elapsed < 60:
            return f"{elapsed:.1f} s"
        minutes, seconds = divmod(int(elapsed), 60)
        hours, minutes = divmod(minutes, 60)
        return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"
