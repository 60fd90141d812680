"""Curves and bars as markup; colours are the page's, so that they suit light and dark."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape

from bundle.reports.page.numbers import amount
from bundle.reports.page.page import tag
from bundle.reports.page.scale import Scale, logarithmic, short

__all__ = [
    "Curve",
    "axes",
    "bars",
    "curves",
    "legend",
    "look",
    "place_x",
    "place_y",
    "stacked_bars",
]

WIDTH, HEIGHT = 480, 320
LEFT, RIGHT, TOP, BOTTOM = 58, 12, 10, 44
COLOURS = 10
DASHES = (None, "7 4", "2 3", "9 3 2 3")


@dataclass(frozen=True)
class Curve:
    """One line: ``colour`` and ``line`` count from 0 and repeat when the page has no more."""

    label: str
    x: Sequence[float]
    y: Sequence[float]
    colour: int = 0
    line: int = 0


def curves(
    lines: Sequence[Curve], x_scale: Scale, y_scale: Scale, x_label: str, y_label: str
) -> str:
    """Return a chart of stairs, each value holding until the next, and its legend."""
    drawn = [
        tag(
            "path",
            tag("title", escape(line.label)),
            d=_stairs(line, x_scale, y_scale),
            **look(line),
        )
        for line in lines
        if len(line.x)
    ]
    chart = tag(
        "svg",
        *axes(x_scale, y_scale, x_label, y_label),
        *drawn,
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        role="img",
        aria_label=f"{y_label} against {x_label}",
    )
    return chart + legend(lines)


def bars(
    values: Mapping[str, float],
    *,
    impossible: Sequence[str] = (),
    show: Callable[[float], str] = amount,
    rows_shown: int | None = None,
) -> str:
    """Return horizontal bars on a log scale; NaN and 0 have none, impossible ones are hatched.

    Bars beyond the first `rows_shown` are folded away, on the same scale; a single one is not.
    """
    scale = logarithmic([value / 3 for value in values.values()] + [*values.values()])
    longest = 46.0 if impossible else 66.0  # leaves room for what is written behind
    rows: list[str] = []
    for name, value in values.items():
        there = math.isfinite(value) and value > 0
        width = longest * scale(value) if there else 0.0
        kind = "bar impossible" if name in impossible else "bar"
        words = show(value) if there else "none"
        words += ", does not fit" if name in impossible else ""
        rows.append(tag("div", escape(name)))
        bar = tag("div", class_=kind, style=f"width:{width:.2f}%")
        rows.append(tag("div", bar, tag("div", escape(words), class_="value"), class_="track"))
    shown = len(values) if rows_shown is None or len(values) <= rows_shown + 1 else rows_shown
    chart = tag("div", *rows[: 2 * shown], class_="bars")
    if shown < len(values):
        summary = tag("summary", f"{len(values) - shown} more")
        chart += tag("details", summary, tag("div", *rows[2 * shown :], class_="bars"))
    return chart


def stacked_bars(rows: Mapping[str, Mapping[str, float]], unit: str) -> str:
    """Return horizontal bars of parts that add up, and their legend; "rest" is grey."""
    totals = {name: sum(parts.values()) for name, parts in rows.items()}
    longest = max(totals.values(), default=1.0) or 1.0
    phases = list(next(iter(rows.values()), {}))
    cells = []
    for name, parts in rows.items():
        pieces = [
            tag(
                "div",
                class_="bar",
                title=f"{phase}: {seconds:.3g}{unit}",
                style=f"width:{74.0 * seconds / longest:.3f}%;background:{_paint(index, phase)}",
            )
            for index, (phase, seconds) in enumerate(parts.items())
        ]
        total = tag("div", f"{totals[name]:.3g}{unit}", class_="value")
        cells += [tag("div", escape(name)), tag("div", *pieces, total, class_="track")]
    swatches = [
        tag("li", _swatch(f"background:{_paint(index, phase)}"), escape(phase))
        for index, phase in enumerate(phases)
    ]
    return tag("div", *cells, class_="bars") + tag("ul", *swatches, class_="legend")


def look(line: Curve) -> dict[str, str | None]:
    """Return the attributes of a path that is drawn as a curve."""
    return {
        "class_": "curve",
        "style": f"stroke:var(--c{line.colour % COLOURS})",
        "stroke_dasharray": DASHES[line.line % len(DASHES)],
    }


def _stairs(line: Curve, x_scale: Scale, y_scale: Scale) -> str:
    points = [
        (place_x(x_scale(x)), place_y(y_scale(y))) for x, y in zip(line.x, line.y, strict=True)
    ]
    steps = "".join(f"H{x:.1f}V{y:.1f}" for x, y in points[1:])
    return f"M{points[0][0]:.1f} {points[0][1]:.1f}{steps}"


def axes(x_scale: Scale, y_scale: Scale, x_label: str, y_label: str) -> list[str]:
    """Return grid lines, ticks and labels of a chart."""
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM
    parts = []
    for tick in x_scale.ticks:
        x = f"{place_x(x_scale(tick)):.1f}"
        parts.append(tag("line", class_="line", x1=x, x2=x, y1=TOP, y2=bottom))
        words = escape(short(tick))
        anchor = "middle"
        if place_x(x_scale(tick)) + 3.8 * len(words) > WIDTH:  # half of its width
            x, anchor = f"{WIDTH - 1}", "end"
        parts.append(tag("text", words, class_="tick", x=x, y=bottom + 16, text_anchor=anchor))
    for tick in y_scale.ticks:
        y = place_y(y_scale(tick))
        parts.append(tag("line", class_="line", x1=LEFT, x2=right, y1=f"{y:.1f}", y2=f"{y:.1f}"))
        words = escape(short(tick))
        parts.append(
            tag("text", words, class_="tick", x=LEFT - 6, y=f"{y + 4:.1f}", text_anchor="end")
        )
    middle = (LEFT + right) / 2
    parts.append(tag("text", escape(x_label), x=middle, y=HEIGHT - 6, text_anchor="middle"))
    turned = f"translate(14 {(TOP + bottom) / 2}) rotate(-90)"
    parts.append(tag("text", escape(y_label), transform=turned, text_anchor="middle"))
    return parts


def legend(lines: Sequence[Curve]) -> str:
    """Return the names of curves beside their strokes."""
    entries = []
    for line in lines:
        stroke = tag("path", d="M0 5H30", **look(line))
        swatch = tag("svg", stroke, viewBox="0 0 30 10", aria_hidden="true")
        entries.append(tag("li", swatch, escape(line.label)))
    return tag("ul", *entries, class_="legend")


def _swatch(style: str) -> str:
    return tag("span", class_="swatch", style=style, aria_hidden="true")


def _paint(index: int, phase: str) -> str:
    return "var(--rest)" if phase == "rest" else f"var(--c{index % COLOURS})"


def place_x(share: float) -> float:
    """Return the place of a value on the x axis, 0 to 1, in the drawing."""
    return LEFT + share * (WIDTH - LEFT - RIGHT)


def place_y(share: float) -> float:
    """Return the place of a value on the y axis, 0 to 1, in the drawing."""
    return HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM)
