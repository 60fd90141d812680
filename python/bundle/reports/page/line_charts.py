"""Charts of lines: with a band about them, and places on the x axis marked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from bundle.reports.page.page import tag
from bundle.reports.page.scale import Scale
from bundle.reports.page.svg_charts import (
    BOTTOM,
    HEIGHT,
    TOP,
    WIDTH,
    Curve,
    axes,
    legend,
    look,
    place_x,
    place_y,
)

__all__ = ["Band", "dots", "error_bars", "lines"]


@dataclass(frozen=True)
class Band:
    """What lies between two lines over the same places."""

    x: Sequence[float]
    low: Sequence[float]
    high: Sequence[float]
    colour: int = 0


def lines(
    drawn: Sequence[Curve],
    x_scale: Scale,
    y_scale: Scale,
    x_label: str,
    y_label: str,
    *,
    bands: Sequence[Band] = (),
    marks: Mapping[str, float] | None = None,
    extra: str = "",
) -> str:
    """Return a chart and its legend.

    Args:
        drawn: lines, broken where a value is not finite.
        x_scale: of the axis.
        y_scale: of the axis.
        x_label: with its unit.
        y_label: with its unit.
        bands: shaded.
        marks: places on the x axis, each a dashed vertical line with its label.
        extra: more markup on top.
    """
    shades = [_shade(band, x_scale, y_scale) for band in bands]
    paths = [
        tag("path", tag("title", escape(line.label)), d=path, **look(line))
        for line in drawn
        if (path := _path(line.x, line.y, x_scale, y_scale))
    ]
    chart = tag(
        "svg",
        *axes(x_scale, y_scale, x_label, y_label),
        *shades,
        *_marks(marks or {}, x_scale),
        *paths,
        extra,
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        role="img",
        aria_label=f"{y_label} against {x_label}",
    )
    return chart + legend(drawn)


def dots(line: Curve, x_scale: Scale, y_scale: Scale) -> str:
    """Return a dot for each finite value."""
    return "".join(
        tag(
            "circle",
            tag("title", escape(line.label)),
            cx=f"{place_x(x_scale(x)):.1f}",
            cy=f"{place_y(y_scale(y)):.1f}",
            r=2.6,
            style=f"fill:var(--c{line.colour})",
        )
        for x, y in zip(line.x, line.y, strict=True)
        if math.isfinite(x) and math.isfinite(y)
    )


def error_bars(line: Curve, errors: Sequence[float], x_scale: Scale, y_scale: Scale) -> str:
    """Return a dot for each value and a bar of one standard error to both sides."""
    parts = []
    colour = f"var(--c{line.colour})"
    for x, y, error in zip(line.x, line.y, errors, strict=True):
        if not math.isfinite(y):
            continue
        place = f"{place_x(x_scale(x)):.1f}"
        if math.isfinite(error):
            low, high = (f"{place_y(y_scale(y + sign * error)):.1f}" for sign in (-1, 1))
            parts.append(tag("line", x1=place, x2=place, y1=low, y2=high, style=f"stroke:{colour}"))
        middle = f"{place_y(y_scale(y)):.1f}"
        parts.append(tag("circle", cx=place, cy=middle, r=2.6, style=f"fill:{colour}"))
    return "".join(parts)


def _path(x: Sequence[float], y: Sequence[float], x_scale: Scale, y_scale: Scale) -> str:
    pieces, pen = [], "M"
    for a, b in zip(x, y, strict=True):
        if math.isfinite(a) and math.isfinite(b):
            pieces.append(f"{pen}{place_x(x_scale(a)):.1f} {place_y(y_scale(b)):.1f}")
            pen = "L"
        else:
            pen = "M"
    return "".join(pieces)


def _shade(band: Band, x_scale: Scale, y_scale: Scale) -> str:
    there = _path(band.x, band.high, x_scale, y_scale)
    back = _path([*reversed(band.x)], [*reversed(band.low)], x_scale, y_scale)
    if not there or not back:
        return ""
    style = f"fill:var(--c{band.colour});fill-opacity:0.22;stroke:none"
    return tag("path", d=f"{there}L{back[1:]}Z", style=style, class_="band")


def _marks(marks: Mapping[str, float], x_scale: Scale) -> list[str]:
    parts = []
    for level, (label, value) in enumerate(marks.items()):
        share = x_scale(value)
        x = f"{place_x(share):.1f}"
        parts.append(tag("line", class_="mark", x1=x, x2=x, y1=TOP, y2=HEIGHT - BOTTOM))
        left = share > 0.5
        # Beside the outermost line of its half, so that no line crosses it.
        half = [place_x(x_scale(v)) for v in marks.values() if (x_scale(v) > 0.5) == left]
        beside = min(half) - 5 if left else max(half) + 5
        parts.append(
            tag(
                "text",
                escape(label),
                class_="tick",
                x=f"{beside:.1f}",
                y=TOP + 14 + 16 * level,
                text_anchor="end" if left else "start",
            )
        )
    return parts
