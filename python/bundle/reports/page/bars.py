"""Bar charts and matrices as markup, in rows of text that wraps and that readers can copy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from bundle.figures.marks import Bars, Matrix, StackedBars
from bundle.reports.page.page import tag

COLOURS = 10
"""Colours of a page, ``--c0`` and so on."""


def bars(mark: Bars) -> str:
    """Return horizontal bars on a log scale; NaN and 0 get no bar, impossible bars are hatched.

    If two or more bars follow the first ``most``, they are folded away, on the same scale.
    """
    scale = mark.scale
    longest = 46.0 if mark.impossible else 66.0  # leaves room for the text to the right
    rows: list[str] = []
    for name, value in mark.rows().items():
        width = longest * scale(value) if math.isfinite(value) and value > 0 else 0.0
        kind = "bar impossible" if name in mark.impossible else "bar"
        rows += _row(name, tag("div", class_=kind, style=f"width:{width:.2f}%"), mark.text(name))
    most, count = mark.most, len(rows) // 2
    shown = count if most is None or count <= most + 1 else most
    kind = "bars dense" if mark.is_ordered else "bars"
    chart = tag("div", *rows[: 2 * shown], class_=kind)
    if shown < count:
        summary = tag("summary", f"{count - shown} more")
        chart += tag("details", summary, tag("div", *rows[2 * shown :], class_=kind))
    return chart


def matrix(mark: Matrix) -> str:
    """Return a matrix as a table; a stronger correlation is more opaque, in both themes."""
    head = tag("tr", tag("th", ""), *(tag("th", escape(name), scope="col") for name in mark.names))
    rows = [
        tag("tr", tag("th", escape(name), scope="row"), *(
            tag("td", text, data_label=other, style=_shade(value) if other != name else None)
            for other, value, text in zip(mark.names, values, texts, strict=True)
        ))
        for name, values, texts in zip(mark.names, mark.values.tolist(), mark.texts(), strict=True)
    ]  # fmt: skip
    inner = tag("table", tag("thead", head), tag("tbody", *rows), class_="matrix")
    return tag("div", inner, class_="scroll", tabindex=0)


def _shade(value: float) -> str:
    share = round(45 * min(abs(value), 1.0)) if math.isfinite(value) else 0
    return f"background:color-mix(in srgb, var(--c{1 if value > 0 else 0}) {share}%, transparent)"


def stacked_bars(mark: StackedBars) -> str:
    """Return horizontal stacked bars and their legend; the part named "rest" is grey."""
    totals = {name: sum(parts.values()) for name, parts in mark.rows.items()}
    longest = max(totals.values(), default=1.0) or 1.0
    phases: Sequence[str] = list(next(iter(mark.rows.values()), {}))
    cells = []
    for name, parts in mark.rows.items():
        pieces = [
            tag(
                "div",
                class_="bar",
                title=f"{phase}: {value:.3g}{mark.unit}",
                style=f"width:{74.0 * value / longest:.3f}%;background:{_paint(index, phase)}",
            )
            for index, (phase, value) in enumerate(parts.items())
        ]
        cells += _row(name, "".join(pieces), f"{totals[name]:.3g}{mark.unit}")
    swatches = [
        tag("li", _swatch(f"background:{_paint(index, phase)}"), escape(phase))
        for index, phase in enumerate(phases)
    ]
    return tag("div", *cells, class_="bars") + tag("ul", *swatches, class_="legend")


def _row(name: str, bar: str, words: str) -> list[str]:
    value = tag("div", escape(words), class_="value")
    return [tag("div", escape(name)), tag("div", bar, value, class_="track")]


def _swatch(style: str) -> str:
    return tag("span", class_="swatch", style=style, aria_hidden="true")


def _paint(index: int, phase: str) -> str:
    return "var(--rest)" if phase == "rest" else f"var(--c{index % COLOURS})"
