"""How numbers, tables and paragraphs look, on a terminal and in a pipe alike."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Sequence
from typing import TextIO

from rich.console import Console, RenderableType
from rich.table import Table
from rich.text import Text

from bundle.words import format_name, number, pixels, plural, seconds

__all__ = [
    "WIDEST",
    "columns",
    "console",
    "facts",
    "format_name",
    "notes",
    "number",
    "pixels",
    "plural",
    "render",
    "seconds",
]

NARROWEST, WIDEST = 60, 100
LABEL_WIDTH = 16


def console(file: TextIO) -> Console:
    """Return a console that colours only a terminal and never interprets what it prints."""
    probe = Console(file=file)
    width = probe.width if probe.is_terminal or "COLUMNS" in os.environ else WIDEST
    return Console(
        file=file,
        width=min(max(width, NARROWEST), WIDEST),
        markup=False,
        emoji=False,
        highlight=False,
    )


def render(*renderables: RenderableType, width: int = WIDEST) -> str:
    """Return renderables as plain lines, without colours or trailing blanks."""
    file = io.StringIO()
    plain = Console(
        file=file, width=width, markup=False, emoji=False, highlight=False, color_system=None
    )
    for renderable in renderables:
        plain.print(renderable)
    return "".join(f"{line.rstrip()}\n" for line in file.getvalue().splitlines())


def facts(rows: Iterable[tuple[str, str]]) -> Table:
    """Return labels at the left, facts at the right; long facts wrap under themselves."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True, min_width=LABEL_WIDTH)
    table.add_column(overflow="fold")
    for label, fact in rows:
        table.add_row(Text(label), Text(fact))
    return table


def columns(head: Sequence[str], rows: Iterable[Sequence[str]], *, left: int = 1) -> Table:
    """Return a table without frames: `left` columns of text, then numbers flush right.

    A row whose first cell starts with "total" stands out.
    """
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for index, title in enumerate(head):
        table.add_column(
            Text(title),
            justify="left" if index < left else "right",
            min_width=LABEL_WIDTH if index == 0 else None,
            no_wrap=index >= left,
        )
    for row in rows:
        style = "bold" if row[0].startswith("total") else None
        table.add_row(*(Text(cell) for cell in row), style=style)
    return table


def notes(sentences: Iterable[str], *, style: str = "") -> list[RenderableType]:
    """Return sentences as dashed paragraphs."""
    table = Table.grid(padding=(0, 1, 0, 0))
    table.add_column(style=style, no_wrap=True)
    table.add_column(style=style, overflow="fold")
    for sentence in sentences:
        table.add_row(Text("-"), Text(sentence))
    return [table] if table.row_count else []
