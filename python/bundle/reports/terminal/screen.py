"""Layout of the sections of a report on a terminal."""

from __future__ import annotations

import shlex
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.text import Text

from bundle.base.tables import columns, facts, notes
from bundle.reports.sections import Report, Section, Table

__all__ = ["CommandLine", "laid_out"]


def laid_out(report: Report | Iterable[Section]) -> list[RenderableType]:
    """Return the sections of a report with an empty line between them."""
    sections = report.sections if isinstance(report, Report) else report
    parts: list[RenderableType] = []
    for section in sections:
        if parts and not section.is_joined:
            parts.append("")
        if section.facts:
            parts.append(facts(section.facts))
        for table in section.tables:
            parts += _table(table)
        parts += section.text
        if section.command:
            parts.append(CommandLine(section.command))
        parts += notes(section.notes, style="yellow" if section.is_warning else "")
    return parts


def _table(table: Table) -> list[RenderableType]:
    made = columns(table.head, table.cells(), left=table.left, keys=table.keys)
    legend = [Text(table.legend, "dim")] if table.legend else []
    return [made, *legend, *notes(table.rest())]


class CommandLine:
    """Command line with backslashes at line breaks, so that it can be copied unchanged."""

    def __init__(self, command: str) -> None:
        self.command = command

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the indented lines."""
        lines: list[str] = []
        for word in map(shlex.quote, shlex.split(self.command)):
            if lines and len(lines[-1]) + len(word) + 3 <= options.max_width:
                lines[-1] += f" {word}"
            else:
                lines.append(f"    {word}" if lines else word)
        yield Text(" \\\n".join(lines), no_wrap=True, overflow="ignore")
