"""Layout of tables, facts and notes, with the same text on a terminal and in a pipe."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TextIO

from rich.console import Console, ConsoleOptions, JustifyMethod, RenderableType, RenderResult
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

__all__ = [
    "WIDEST",
    "Bar",
    "Columns",
    "columns",
    "console",
    "facts",
    "notes",
    "render",
]

NARROWEST, WIDEST = 60, 100
LABEL_WIDTH = 16
GUTTER = 2
NARROWEST_BAR, BAR_WIDTH = 8, 40


def console(file: TextIO) -> Console:
    """Return a console that uses colours only on a terminal and prints text without markup."""
    probe = Console(file=file, force_jupyter=False)
    width = probe.width if probe.is_terminal or "COLUMNS" in os.environ else WIDEST
    return _literal_console(file, min(max(width, NARROWEST), WIDEST))


def render(*renderables: RenderableType, width: int = WIDEST) -> str:
    """Return renderables as plain lines, without colours or trailing spaces."""
    file = io.StringIO()
    plain = _literal_console(file, width, color_system=None)
    for renderable in renderables:
        plain.print(renderable, crop=False)
    return "".join(f"{line.rstrip()}\n" for line in file.getvalue().splitlines())


def _literal_console(file: TextIO, width: int, **settings: Any) -> Console:
    return Console(
        file=file,
        width=width,
        markup=False,
        emoji=False,
        highlight=False,
        force_jupyter=False,  # in a notebook rich would display it instead
        **settings,
    )


def facts(rows: Iterable[tuple[str, str]]) -> Table:
    """Return a table with labels at the left and facts at the right; long facts are wrapped."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True, min_width=LABEL_WIDTH)
    table.add_column(overflow="fold")
    for label, fact in rows:
        table.add_row(Text(label), Text(fact))
    return table


class Columns:
    """A table without frames: columns of text, then right-aligned columns of numbers.

    If it is wider than the terminal, text wraps between words. If that is not enough, the table is
    divided into several tables below each other. Each repeats the first `keys` columns. No text is
    cut.
    """

    def __init__(
        self, head: Sequence[str], rows: Iterable[Sequence[RenderableType]], left: int, keys: int
    ) -> None:
        self.head = tuple(map(Text, head))
        self.rows = [
            tuple(Text(cell) if isinstance(cell, str) else cell for cell in row) for row in rows
        ]
        self._left = left
        self._keys = keys

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table, divided if it is wider than the terminal."""
        limit = options.max_width
        sizes = self._sizes(console, options)
        narrowest = [min(size.minimum, limit) for size in sizes]
        narrowest[0] = min(narrowest[0], limit // 2)
        for position, group in enumerate(_groups(narrowest, limit, self._keys)):
            if position:
                yield Text("")
            spare = limit - sum(narrowest[index] + GUTTER for index in group) + GUTTER
            widths = {}
            for index in group:
                taken = min(sizes[index].maximum - narrowest[index], max(spare, 0))
                widths[index] = narrowest[index] + taken
                spare -= taken
            yield self._table(widths)

    def _sizes(self, console: Console, options: ConsoleOptions) -> list[Measurement]:
        """Return, for each column, its width with all line breaks and its width without any."""
        unlimited = options.update_width(10_000)
        sizes = []
        for index, cells in enumerate(zip(self.head, *self.rows, strict=True)):
            found = [Measurement.get(console, unlimited, cell) for cell in cells]
            widest = max(size.maximum for size in found)
            wraps = index < self._left
            narrowest = max(size.minimum for size in found) if wraps else widest
            least = LABEL_WIDTH if index == 0 else 0
            sizes.append(Measurement(max(narrowest, least), max(widest, least)))
        return sizes

    def _table(self, widths: Mapping[int, int]) -> Table:
        table = Table(box=None, pad_edge=False, padding=(0, GUTTER, 0, 0), header_style="bold")
        for index, width in widths.items():
            justify: JustifyMethod = "left" if index < self._left else "right"
            table.add_column(self.head[index], justify=justify, width=width, overflow="fold")
        for row in self.rows:
            style = "bold" if str(row[0]).startswith("total") else None
            table.add_row(*(row[index] for index in widths), style=style)
        return table


def _groups(widths: Sequence[int], limit: int, keys: int) -> list[list[int]]:
    """Return the columns of each table; every table has the first `keys` columns."""
    first = list(range(keys))
    keys_width = sum(widths[:keys]) + GUTTER * (keys - 1)
    groups, used = [[*first]], keys_width
    for index, width in enumerate(widths[keys:], keys):
        if used + GUTTER + width > limit and len(groups[-1]) > keys:
            groups.append([*first])
            used = keys_width
        groups[-1].append(index)
        used += GUTTER + width
    return groups


def columns(
    head: Sequence[str], rows: Iterable[Sequence[RenderableType]], *, left: int = 1, keys: int = 1
) -> Columns:
    """Return a table of `left` columns of text, then numbers; see :class:`Columns`.

    The first `keys` columns identify a row. A row whose first cell starts with "total" is
    highlighted.
    """
    return Columns(head, rows, left, keys)


class Bar:
    """A bar of at most `BAR_WIDTH` characters; shorter on a narrow terminal."""

    def __init__(self, share: float) -> None:
        self._share = share

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the bar; a positive share has at least one character."""
        yield Text("#" * math.ceil(self._share * min(options.max_width, BAR_WIDTH)))

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        """Return the smallest and the largest width of a bar."""
        return Measurement(NARROWEST_BAR, BAR_WIDTH)


def notes(sentences: Iterable[str], *, style: str = "") -> list[RenderableType]:
    """Return sentences as dashed paragraphs."""
    table = Table.grid(padding=(0, 1, 0, 0))
    table.add_column(style=style, no_wrap=True)
    table.add_column(style=style, overflow="fold")
    for sentence in sentences:
        table.add_row(Text("-"), Text(sentence))
    return [table] if table.row_count else []
