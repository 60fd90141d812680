"""Tables, findings and sections of a report as markup."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from html import escape
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from bundle.interface.finding import Finding
from bundle.reports.page.page import command_box, heading, prose, tag
from bundle.reports.page.svg import draw
from bundle.reports.sections import Section, Table

# Length in characters from which a cell counts as a sentence, which wraps.
LONG = 20
# Columns that fit on a page of 800 pixels.
MOST_COLUMNS = 9

CONVENTION = (
    "Nonzeros: matrices count both triangles and the diagonal, L its lower triangle with the "
    "diagonal. Flops of a factorisation: the sum over the columns of L of c² + 3c, c being the "
    "nonzeros below the diagonal."
)


def table(
    head: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    words: Collection[int] = (),
    best: int | None = None,
    rows_shown: int | None = None,
) -> str:
    """Return a table of text; on a narrow page, each row becomes a list of its cells.

    ``words`` are the columns of sentences, which wrap; ``best`` is the highlighted row. Rows after
    ``rows_shown`` are folded away if there are two or more.
    """
    if rows_shown is not None and len(rows) > rows_shown + 1:
        rest = None if best is None else best - rows_shown
        below = table(head, rows[rows_shown:], words=words, best=rest)
        summary = tag("summary", f"{len(rows) - rows_shown} more")
        above = table(head, rows[:rows_shown], words=words, best=best)
        return above + tag("details", summary, below)
    kinds: list[str | None] = [None] * len(head)
    for column in words:
        longest = max((len(row[column]) for row in rows), default=0)
        kinds[column] = "words long" if longest > LONG else "words"
    lines = []
    for index, row in enumerate(rows):
        number = head[0] if row[0].isdigit() else None
        name = tag("th", escape(row[0]).replace("_", "_<wbr>"), scope="row", data_label=number)
        cells = [
            tag("td", escape(cell), class_=kind, data_label=label)
            for cell, kind, label in zip(row[1:], kinds[1:], head[1:], strict=True)
        ]
        lines.append(tag("tr", name, *cells, class_="best" if index == best else None))
    titles = (
        tag("th", escape(name), scope="col", class_=kind)
        for name, kind in zip(head, kinds, strict=True)
    )
    size = "wide" if len(head) > MOST_COLUMNS else None
    inner = tag("table", tag("thead", tag("tr", *titles)), tag("tbody", *lines), class_=size)
    return tag("div", inner, class_="scroll", tabindex=0)


def declared(made: Table) -> str:
    """Return the markup of a table: empty columns left out, rows beyond ``most`` folded, legend."""
    cells = [[str(column.cell(row)) for row in made.rows] for column in made.columns]
    kept = [k for k, column in enumerate(cells) if k < made.left or any(column)]
    head = [made.columns[k].title for k in kept]
    rows = [[cells[k][row] for k in kept] for row in range(len(made.rows))]
    words = [k for k in range(1, len(head)) if k < made.left or head[k] == "note"]
    legend = tag("p", escape(made.legend), class_="quiet") if made.legend else ""
    return table(head, rows, words=words, best=made.best, rows_shown=made.most) + legend


def rounded(values: NDArray[np.float64]) -> list[float]:
    """Return numbers rounded to six digits; NaN is kept, which the page writes as null."""
    return [float(f"{value:.6g}") for value in values.ravel().tolist()]


MOST_FINDINGS = 3
MOST_DETAILS = 3


def rendered(sections: Iterable[Section | str]) -> list[str]:
    """Return the markup of sections; consecutive details after the first are folded together.

    Text is markup already.
    """
    made: list[str] = []
    for is_detail, group in groupby(sections, key=lambda one: getattr(one, "is_detail", False)):
        drawn = [one if isinstance(one, str) else _section(one) for one in group]
        if is_detail and len(drawn) > MOST_DETAILS:
            summary = tag("summary", f"{len(drawn) - 1} more")
            drawn[1:] = [tag("details", summary, *drawn[1:])]
        made += drawn
    return made


def findings_list(findings: Sequence[Finding], shown: Iterable[str] = ()) -> str:
    """Return findings; those beyond the third are folded away.

    ``shown``: commands that the page already shows.
    """
    drawn = [_finding(found, found.command not in {"", *shown}) for found in findings]
    if len(drawn) <= MOST_FINDINGS + 1:
        return "".join(drawn)
    summary = tag("summary", f"{len(drawn) - MOST_FINDINGS} more findings")
    return "".join(drawn[:MOST_FINDINGS]) + tag("details", summary, *drawn[MOST_FINDINGS:])


def _finding(found: Finding, has_command: bool) -> str:
    command = command_box(found.command) if has_command else ""
    kind = "finding problem" if found.is_problem else "finding"
    return tag("div", tag("p", prose(found.sentence)), command, class_=kind)


def _section(section: Section) -> str:
    kind = "warn" if section.is_warning else "quiet"
    facts = [Table.of(("", ""), section.facts, left=2)] if section.facts else []
    tables = [declared(table) for table in [*facts, *section.tables]]
    given = section.figures() if callable(section.figures) else section.figures
    figures = [draw(figure, "h4") for figure in given]
    if len(figures) == len(tables) == 1:  # the table has room beside the figure
        tables, figures = [], [*figures, tag("div", *tables, class_="beside")]
    parts = [
        *(tag("p", prose(str(words)), class_="quiet") for words in section.text),
        *(tag("p", prose(words), class_=kind) for words in section.notes),
        *tables,
        tag("div", *figures, class_="grid") if figures else "",
        command_box(section.command) if section.command else "",
    ]
    if section.is_detail and section.title:
        return tag("details", tag("summary", escape(section.title)), *parts)
    title = tag("h3", escape(section.title)) if section.is_joined else heading(section.title)
    return (title if section.title else "") + "".join(parts)
