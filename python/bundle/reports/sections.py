"""Reports of commands as data: sections and tables for people, JSON for programs.

A command computes a :class:`Report`. Terminals show its sections
(:func:`bundle.reports.terminal.screen.laid_out`), and ``--json`` writes its data. Rows of tables
are rounded and limited in number; data are complete.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle._core import __version__
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.interface.finding import Finding

if TYPE_CHECKING:
    from bundle.base.display import Display
    from bundle.figures.marks import Figure

SCHEMA = 1


@dataclass(frozen=True)
class Column:
    """Column of a table with its title and unit.

    The value of a cell is an attribute of the row, such as "error.rmse", an index, if rows are
    tuples, or a function of the row. Terminals have no room for a column that ``is_page_only``.
    """

    title: str
    value: str | int | Callable[[Any], Any]
    format: Callable[[Any], str] = str
    is_page_only: bool = False

    def cell(self, row: Any) -> Any:
        """Return the cell of a row: text or a renderable."""
        if isinstance(self.value, int):
            return row[self.value]
        find = self.value if callable(self.value) else attrgetter(self.value)
        return self.format(find(row))


@dataclass(frozen=True, eq=False)
class Table:
    """Table of a report; the columns read its rows.

    The first ``left`` columns are text, aligned to the left; the first ``keys`` identify a row. At
    most ``most`` rows are shown; ``others`` makes a sentence about hidden rows. ``legend`` is below
    the table, and ``best`` the index of a row that pages highlight.
    """

    columns: Sequence[Column]
    rows: Sequence[Any]
    left: int = 1
    keys: int = 1
    most: int | None = None
    others: Callable[[int], str] | None = None
    legend: str = ""
    best: int | None = None

    @staticmethod
    def of(head: Iterable[str], rows: Iterable[Sequence[Any]], **more: Any) -> Table:
        """Return a table of given cells."""
        return Table([Column(title, k) for k, title in enumerate(head)], [*rows], **more)

    @property
    def head(self) -> tuple[str, ...]:
        """Titles of the columns on a terminal."""
        return tuple(column.title for column in self.columns if not column.is_page_only)

    def cells(self) -> list[tuple[Any, ...]]:
        """Return the cells of the rows that a terminal shows."""
        columns = [column for column in self.columns if not column.is_page_only]
        return [tuple(column.cell(row) for column in columns) for row in self.rows[: self.most]]

    def rest(self) -> list[str]:
        """Return the sentence about hidden rows; empty if all rows are shown."""
        count = 0 if self.most is None else len(self.rows) - self.most
        return [self.others(count)] if self.others is not None and count > 0 else []


@dataclass(frozen=True, eq=False, kw_only=True)
class Section:
    """Section of a report, with an empty line above it.

    Facts, labelled, are first, then tables without empty lines between them, text, a command line
    to copy, and notes. Figures, or a function that makes them, are for pages.
    """

    facts: Sequence[tuple[str, str]] = ()
    tables: Sequence[Table] = ()
    text: Sequence[Any] = ()
    command: str = ""
    notes: Sequence[str] = ()
    is_warning: bool = False  # True if the notes are warnings
    is_joined: bool = False  # True to omit the empty line above
    is_detail: bool = False  # True to show the section with --verbose only; pages fold it away
    is_page_only: bool = False  # True to show the section on pages only
    # heading on a page, and its entry in the contents; of a joined section a lower heading; of a
    # detail the text of the fold
    title: str = ""
    figures: Sequence[Figure] | Callable[[], Sequence[Figure]] = ()


def displayed(displays: Iterable[Display], **more: Any) -> list[Section]:
    """Return facts and tables of results as sections."""
    return [
        Section(
            title=one.title,
            facts=one.facts,
            tables=[Table.of(one.head, one.rows, left=one.left, most=one.most, others=_others)]
            if one.rows
            else (),
            **more,
        )
        for one in displays
    ]


def _others(count: int) -> str:
    return f"{plural(count, 'other image')} as well; --json FILE lists all"


@dataclass(frozen=True, eq=False, kw_only=True)
class Report:
    """Report of a command."""

    command: str
    input: Mapping[str, Any] | None = None  # path, format, counts; None if the data contain them
    headline: Sequence[str] = ()  # verdict in sentences
    warnings: Sequence[str] = ()  # sentences that restrict the headline
    findings: Sequence[Finding] = ()  # facts to act on, the most important first
    sections: Sequence[Section] = ()
    data: Mapping[str, Any] = field(default_factory=dict)  # beside schema, command, version, input
    title: str = ""  # title of the page of these sections; "": another page, or none

    def json(self) -> dict[str, Any]:
        """Return the JSON report, in JSON types."""
        given = {} if self.input is None else {"input": self.input}
        verdict = {"headline": self.headline, "findings": self.findings}
        report: dict[str, Any] = plain({**heading(self.command), **given, **verdict, **self.data})
        return report | {"findings": [_finding(found) for found in report["findings"]]}


def _finding(found: dict[str, Any]) -> dict[str, Any]:
    """Return a finding of any kind with the keys of all: other fields are its evidence."""
    evidence = {key: found[key] for key in found if key not in ("kind", "sentence", "command")}
    return {"command": "", "evidence": evidence, **found}


def heading(command: str) -> dict[str, Any]:
    """Return the first entries of every report."""
    return {"schema": SCHEMA, "command": command, "version": __version__}


def several(command: str, reports: Sequence[Report]) -> Report:
    """Return one report from the reports on several inputs."""
    return Report(
        command=command,
        sections=[section for report in reports for section in _whole(report)],
        data={"reports": [report.json() for report in reports]},
    )


def _whole(report: Report) -> Iterator[Section]:
    """Yield headline, warnings, sections and findings of a report as sections."""
    if report.headline:
        yield Section(text=report.headline)
    if report.warnings:
        yield Section(notes=report.warnings, is_warning=True, is_joined=True)
    yield from report.sections
    for finding in report.findings:
        yield Section(notes=[finding.sentence], is_warning=True)
        if finding.command:
            yield Section(command=finding.command, is_joined=True)


def dumps(report: dict[str, Any]) -> str:
    """Return a report as text: ASCII, indented, ending in a newline."""
    return json.dumps(report, indent=2, allow_nan=False) + "\n"


def fields(record: Any) -> dict[str, Any]:
    """Return the fields of a dataclass by name."""
    return {one.name: getattr(record, one.name) for one in dataclasses.fields(record)}


def plain(value: Any) -> Any:
    """Return a value in JSON types: arrays and dataclasses converted, NaN as None."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = fields(value)
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    return value


def records(columns: Mapping[str, NDArray[Any]]) -> list[dict[str, Any]]:
    """Return one dictionary per entry, from arrays of equal length by name."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]
