"""Tables, numbered notes, and the convention of counts."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from bundle.reports.page.page import tag
from bundle.reports.sections import Table

# Length in characters from which a cell counts as a sentence, which wraps.
LONG = 20
# Columns that fit on a page of 800 pixels.
MOST_COLUMNS = 7

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

    Args:
        head: names of the columns.
        rows: cells; the first cell of a row is its name.
        words: columns of sentences, which wrap.
        best: index of the highlighted row.
        rows_shown: number of visible rows; the others are folded away if there are two or more.
            None shows all rows.
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
        name = tag("th", escape(row[0]), scope="row")
        cells = [
            tag("td", escape(cell), class_=kind, data_label=label)
            for cell, kind, label in zip(row[1:], kinds[1:], head[1:], strict=True)
        ]
        lines.append(tag("tr", name, *cells, class_="best" if index == best else None))
    heading = tag(
        "tr",
        *(
            tag("th", escape(name), scope="col", class_=kind)
            for name, kind in zip(head, kinds, strict=True)
        ),
    )
    size = "wide" if len(head) > MOST_COLUMNS else None
    inner = tag("table", tag("thead", heading), tag("tbody", *lines), class_=size)
    return tag("div", inner, class_="scroll", tabindex=0)


def declared(made: Table) -> str:
    """Return the markup of a :class:`Table` with its legend; rows beyond ``most`` are folded."""
    head = [column.title for column in made.columns]
    rows = [[str(column.cell(row)) for column in made.columns] for row in made.rows]
    words = [k for k in range(1, len(head)) if k < made.left or made.columns[k].title == "note"]
    legend = tag("p", escape(made.legend), class_="quiet") if made.legend else ""
    return table(head, rows, words=words, best=made.best, rows_shown=made.most) + legend


class Notes:
    """Sentences that rows reference by number; each sentence is listed once."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}

    def refer(self, note: str) -> str:
        """Return the number of a note; "" for an empty note."""
        return str(self._numbers.setdefault(note, len(self._numbers) + 1)) if note else ""

    def listed(self) -> str:
        """Return the referenced notes."""
        lines = [tag("li", escape(note)) for note in self._numbers]
        return tag("ol", *lines, class_="quiet") if lines else ""


def rounded(values: NDArray[np.float64]) -> list[float]:
    """Return numbers rounded to six digits; NaN is kept, which the page writes as null."""
    return [float(f"{value:.6g}") for value in values.ravel().tolist()]
