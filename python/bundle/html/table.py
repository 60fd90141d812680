"""Tables, and how numbers look in them."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from html import escape

from bundle.html.page import tag

__all__ = ["amount", "convention", "memory", "seconds", "table"]

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


def amount(value: float) -> str:
    """Return a count in full up to seven digits, else with three of them; "-" for none."""
    if not math.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) < 1e7 else f"{value:.2e}"


def memory(size: float) -> str:
    """Return bytes as kB, MB or GB (10^9 bytes); "-" where unknown."""
    if not math.isfinite(size) or size < 0:
        return "-"
    if size >= 1e9:
        return f"{size / 1e9:.2f} GB"
    return f"{size / 1e6:.0f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"


def seconds(time: float) -> str:
    """Return a duration; "-" where there is none."""
    if not math.isfinite(time) or time < 0:
        return "-"
    return f"{time:.1f} s" if time >= 10 else f"{time:.3f} s"
