"""Bar charts as markup: a name, a bar and a value per row."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from bundle.figures.axes import logarithmic
from bundle.figures.marks import Bars, StackedBars
from bundle.reports.page.page import tag

__all__ = ["COLOURS", "bars", "stacked_bars"]

COLOURS = 10
"""Colours of a page, ``--c0`` and so on."""


def bars(mark: Bars) -> str:
    """Return horizontal bars on a log scale; NaN and 0 get no bar, impossible bars are hatched.

    If two or more bars follow the first ``most``, they are folded away, on the same scale.
    """
    values = mark.values
    if mark.is_ordered:
        values = {name: value for name, value in values.items() if value}
    scale = logarithmic([value / 3 for value in values.values()] + [*values.values()])
    longest = 46.0 if mark.impossible else 66.0  # leaves room for the text to the right
    rows: list[str] = []
    for name, value in values.items():
        there = math.isfinite(value) and value > 0
        width = longest * scale(value) if there else 0.0
        kind = "bar impossible" if name in mark.impossible else "bar"
        words = mark.show(value) if there else "none"
        words += ", does not fit" if name in mark.impossible else ""
        bar = tag("div", class_=kind, style=f"width:{width:.2f}%")
        rows += _row(name, bar, words)
    most, count = mark.most, len(values)
    shown = count if most is None or count <= most + 1 else most
    chart = tag("div", *rows[: 2 * shown], class_="bars")
    if shown < count:
        summary = tag("summary", f"{count - shown} more")
        chart += tag("details", summary, tag("div", *rows[2 * shown :], class_="bars"))
    return chart


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
