"""Tables, and the sentence that says what their numbers count."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from html import escape

from bundle.html.page import tag

__all__ = ["convention", "table"]

# Characters of a sentence that wraps.
LONG = 20

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
) -> str:
    """Return a table of text that scrolls by itself where the page is narrow.

    Args:
        head: names of the columns.
        rows: cells; the first of a row names it.
        words: columns that hold sentences, which wrap.
        best: the row to stand out.
    """
    kinds: list[str | None] = [None] * len(head)
    for column in words:
        longest = max((len(row[column]) for row in rows), default=0)
        kinds[column] = "words long" if longest > LONG else "words"
    lines = []
    for index, row in enumerate(rows):
        name = tag("th", escape(row[0]), scope="row")
        cells = [
            tag("td", escape(cell), class_=kind)
            for cell, kind in zip(row[1:], kinds[1:], strict=True)
        ]
        lines.append(tag("tr", name, *cells, class_="best" if index == best else None))
    heading = tag(
        "tr",
        *(
            tag("th", escape(name), scope="col", class_=kind)
            for name, kind in zip(head, kinds, strict=True)
        ),
    )
    inner = tag("table", tag("thead", heading), tag("tbody", *lines))
    return tag("div", inner, class_="scroll", tabindex=0)


def convention() -> str:
    """Return the sentence that says what is counted."""
    return tag("p", CONVENTION, class_="convention")
