"""Sections of a report as markup: the page's rendering of :class:`Section`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from itertools import groupby

from bundle.interface.finding import Finding
from bundle.reports.page.page import heading, tag
from bundle.reports.page.svg import draw
from bundle.reports.page.table import declared
from bundle.reports.sections import Section, Table

MOST_FINDINGS = 3
MOST_DETAILS = 3


def rendered(sections: Iterable[Section | str]) -> list[str]:
    """Return the markup of sections; of many details in a row all but the first are one fold.

    Text is markup already.
    """
    made: list[str] = []
    for is_detail, group in groupby(sections, key=_is_detail):
        drawn = [one if isinstance(one, str) else _section(one) for one in group]
        if is_detail and len(drawn) > MOST_DETAILS:
            summary = tag("summary", f"{len(drawn) - 1} more")
            drawn[1:] = [tag("details", summary, *drawn[1:])]
        made += drawn
    return made


def findings_list(findings: Sequence[Finding]) -> str:
    """Return findings with their commands; those beyond the third are folded away."""
    drawn = [_finding(found) for found in findings]
    if len(drawn) <= MOST_FINDINGS + 1:
        return "".join(drawn)
    summary = tag("summary", f"{len(drawn) - MOST_FINDINGS} more findings")
    return "".join(drawn[:MOST_FINDINGS]) + tag("details", summary, *drawn[MOST_FINDINGS:])


def _is_detail(section: Section | str) -> bool:
    return isinstance(section, Section) and section.is_detail


def _finding(found: Finding) -> str:
    command = tag("pre", tag("code", escape(found.command))) if found.command else ""
    kind = "finding problem" if found.is_problem else "finding"
    return tag("div", tag("p", escape(found.sentence)), command, class_=kind)


def _section(section: Section) -> str:
    kind = "warn" if section.is_warning else "quiet"
    facts = [Table.of(("", ""), section.facts, left=2)] if section.facts else []
    tables = [declared(table) for table in [*facts, *section.tables]]
    given = section.figures() if callable(section.figures) else section.figures
    figures = [draw(figure, "h4") for figure in given]
    if len(figures) == len(tables) == 1:  # the table has room beside the figure
        tables, figures = [], [*figures, *tables]
    parts = [
        *(tag("p", escape(str(words)), class_="quiet") for words in section.text),
        *(tag("p", escape(words), class_=kind) for words in section.notes),
        *tables,
        tag("div", *figures, class_="grid") if figures else "",
        tag("pre", tag("code", escape(section.command))) if section.command else "",
    ]
    if section.is_detail:
        return tag("details", tag("summary", escape(section.title or "Details")), *parts)
    title = tag("h3", escape(section.title)) if section.is_joined else heading(section.title)
    return (title if section.title else "") + "".join(parts)
