"""Representation of public objects: lines of text, and a table in a notebook."""

from __future__ import annotations

from bundle.base.records import dataclass


@dataclass(frozen=True, kw_only=True)
class Display:
    """Content of a repr."""

    title: str  # first line
    facts: tuple[tuple[str, str], ...] = ()  # pairs (label, fact), one per line
    # column titles of a table; its first column is text, the other columns are numbers
    head: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()  # cells of the table
    left: int = 1  # number of columns of text in reports
    most: int | None = None  # largest number of rows that reports show; None: all

    def text(self) -> str:
        """Return the content as lines of text."""
        width = max((len(label) for label, _ in self.facts), default=0)
        lines = [f"  {label:<{width}}  {fact}".rstrip() for label, fact in self.facts]
        if self.rows:
            table = (self.head, *self.rows)
            widths = [max(map(len, column)) for column in zip(*table, strict=True)]
            for first, *others in table:
                cells = [f"{first:<{widths[0]}}"]
                cells += [f"{c:>{w}}" for c, w in zip(others, widths[1:], strict=True)]
                lines.append(f"  {'  '.join(cells)}".rstrip())
        return "\n".join([self.title, *lines])

    def html(self) -> str:
        """Return the content as HTML, with all text escaped."""
        from html import escape  # slow to import

        facts = "".join(
            f'<tr><th style="text-align:left">{escape(label)}</th>'
            f'<td style="text-align:left">{escape(fact)}</td></tr>'
            for label, fact in self.facts
        )
        parts = [f"<b>{escape(self.title)}</b>"]
        if facts:
            parts.append(f"<table>{facts}</table>")
        if self.rows:
            head, *rows = (
                "".join(
                    f'<{tag} style="text-align:{side}">{escape(cell)}</{tag}>'
                    for side, cell in zip(("left", *["right"] * len(row)), row, strict=False)
                )
                for tag, row in (("th", self.head), *(("td", row) for row in self.rows))
            )
            body = "".join(f"<tr>{row}</tr>" for row in rows)
            parts.append(f"<table><tr>{head}</tr>{body}</table>")
        return f"<div>{''.join(parts)}</div>"


class Displayed:
    """Base of objects whose repr is defined by :meth:`_display`."""

    def _display(self) -> Display:
        raise NotImplementedError

    def __repr__(self) -> str:
        return self._display().text()

    def _repr_html_(self) -> str:
        return self._display().html()
