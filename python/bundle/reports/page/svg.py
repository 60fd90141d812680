"""Figures as SVG markup; they use the page's colours, which suit light and dark themes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from html import escape
from typing import Any, ClassVar

import numpy as np

from bundle.figures.marks import (
    Array,
    Axis,
    Bars,
    Cells,
    Dots,
    Ellipses,
    Figure,
    Line,
    Matrix,
    Places,
    StackedBars,
    Steps,
    Vectors,
    short,
)
from bundle.reports.page.page import tag
from bundle.reports.page.svg_planes import cells, plane, scale

COLOURS = 10  # colours of a page, ``--c0`` and so on


def bars(mark: Bars) -> str:
    """Return horizontal bars on a log scale; NaN and 0 get no bar, impossible bars are hatched.

    If two or more bars follow the first ``most``, they are folded away, on the same scale.
    """
    scale = mark.scale
    room = _room(map(mark.text, mark.rows()))
    rows: list[str] = []
    for name, value in mark.rows().items():
        share = scale(value) if math.isfinite(value) and value > 0 else 0.0
        kind = "bar impossible" if name in mark.impossible else "bar"
        rows += _row(name, tag("div", class_=kind, style=_width(share, room)), mark.text(name))
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
    texts = {name: f"{total:.3g}{mark.unit}" for name, total in totals.items()}
    room = _room(texts.values())
    cells = []
    paints = {
        phase: "background:var(--rest)" if phase == "rest" else f"background:var(--c{k % COLOURS})"
        for k, phase in enumerate(next(iter(mark.rows.values()), {}))
    }
    for name, parts in mark.rows.items():
        pieces = [
            tag("div", class_="bar", title=f"{phase}: {value:.3g}{mark.unit}",
                style=f"{_width(value / longest, room)};{paints[phase]}")
            for phase, value in parts.items()
        ]  # fmt: skip
        cells += _row(name, "".join(pieces), texts[name])
    swatches = [
        tag("li", tag("span", class_="swatch", style=paint, aria_hidden="true"), escape(phase))
        for phase, paint in paints.items()
    ]
    return tag("div", *cells, class_="bars") + tag("ul", *swatches, class_="legend")


def _room(texts: Iterable[str]) -> float:
    """Return the width of the longest text beside a bar, in em."""
    return 1.0 + 0.65 * max(map(len, texts), default=0)


def _width(share: float, room: float) -> str:
    """Return the style of a bar: a share of what the texts leave, or of 46 % where it is more."""
    return f"width:calc({share:.4f}*max(46%,100% - {room:.1f}em))"


def _row(name: str, bar: str, words: str) -> list[str]:
    value = tag("div", escape(words), class_="value")
    label = escape(name).replace("_", "_<wbr>")
    return [tag("div", label), tag("div", bar, value, class_="track")]


WIDTH, HEIGHT = 480, 320
LEFT, RIGHT, TOP, BOTTOM = 58, 12, 10, 44
DASHES = (None, "7 4", "2 3", "9 3 2 3")
LETTER = 7.4  # width of one letter of a label


def draw(figure: Figure, heading: str = "h3") -> str:
    """Return a figure with its title, in an element ``heading``, and its note."""
    title = tag(heading, escape(figure.title)) if figure.title else ""
    note = tag("figcaption", escape(figure.note)) if figure.note else ""
    return tag("figure", title, drawing(figure), note, data_figure=figure.name)


def grid(figures: Iterable[Figure], heading: str = "h3", class_: str = "grid") -> str:
    """Return figures side by side."""
    return tag("div", *(draw(figure, heading) for figure in figures), class_=class_)


def drawing(figure: Figure) -> str:
    """Return the figure with its legend, without title and note."""
    if figure.is_image:
        return plane(figure)
    for mark in figure.marks:
        if type(mark) in _ROWS:
            return _ROWS[type(mark)](mark)
    chart = _Chart(figure.x, figure.y)
    # Draw bands and places below lines, error bars and dots.
    layers = [
        [chart.band(mark) for mark in figure.marks if isinstance(mark, Line)],
        [chart.places(mark) for mark in figure.marks if isinstance(mark, Places)],
        [chart.mark(mark) for mark in figure.marks if not isinstance(mark, Places)],
        [chart.dots_of_line(mark) for mark in figure.marks if isinstance(mark, Line)],
    ]
    label = f"{figure.y.label} against {figure.x.label}"
    inside = [part for layer in layers for part in layer]
    made = tag(
        "svg", *chart.axes(), *inside,
        viewBox=f"0 0 {WIDTH} {HEIGHT}", role="img", aria_label=label,
    )  # fmt: skip
    made += _legend(figure.legend) if figure.legend else ""
    return made + "".join(map(scale, figure.marks))


_ROWS: dict[type, Callable[..., str]] = {Bars: bars, StackedBars: stacked_bars, Matrix: matrix}


class _Chart:
    """Area of a chart; it places marks in the drawing."""

    def __init__(self, x: Axis, y: Axis) -> None:
        self._x, self._y = x, y

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Return the position of a point of the axes in the drawing."""
        return self._across(x), HEIGHT - BOTTOM - self._y(y) * (HEIGHT - TOP - BOTTOM)

    def _across(self, x: float) -> float:
        return LEFT + self._x(x) * (WIDTH - LEFT - RIGHT)

    def axes(self) -> list[str]:
        """Return grid lines, ticks and labels."""
        right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM
        parts = []
        for tick in self._x.ticks:
            place = self._across(tick)
            x, anchor, words = f"{place:.1f}", "middle", escape(short(tick))
            parts.append(tag("line", class_="line", x1=x, x2=x, y1=TOP, y2=bottom))
            if place + 3.8 * len(words) > WIDTH:  # half of its width
                x, anchor = f"{WIDTH - 1}", "end"
            parts.append(tag("text", words, class_="tick", x=x, y=bottom + 16, text_anchor=anchor))
        for tick in self._y.ticks:
            y = self.place(self._x.low, tick)[1]
            at = f"{y:.1f}"
            parts.append(tag("line", class_="line", x1=LEFT, x2=right, y1=at, y2=at))
            words = escape(short(tick))
            parts.append(
                tag("text", words, class_="tick", x=LEFT - 6, y=f"{y + 4:.1f}", text_anchor="end")
            )
        middle = (LEFT + right) / 2
        label = escape(self._x.label)
        parts.append(tag("text", label, x=middle, y=HEIGHT - 6, text_anchor="middle"))
        turned = f"translate(13 {(TOP + bottom) / 2}) rotate(-90)"
        parts.append(tag("text", escape(self._y.label), transform=turned, text_anchor="middle"))
        return parts

    def mark(self, mark: Any) -> str:
        """Return a mark; empty if it has no points on the axes."""
        return self._KINDS[type(mark)](self, mark)

    def _cells(self, mark: Cells) -> str:
        return cells(mark, np.array([LEFT, TOP]), (WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM))

    def _line(self, line: Line) -> str:
        path = "" if line.is_dotted else self._path(line.x, line.y)
        return _curve(line, path) if path else ""

    def _steps(self, steps: Steps) -> str:
        if len(steps.x) == 0:
            return ""
        y = [*steps.y.tolist(), *steps.y[-1:].tolist()][: len(steps.x)]
        (x0, y0), *corners = (self.place(a, b) for a, b in zip(steps.x.tolist(), y, strict=True))
        if not corners:  # a run of one step
            return _dot(x0, y0, 3.4, steps.colour, steps.label)
        path = f"M{x0:.1f} {y0:.1f}" + "".join(f"H{a:.1f}V{b:.1f}" for a, b in corners)
        return _curve(steps, path)

    def _dots(self, dots: Dots) -> str:
        at = [self.place(x, y) for x, y in dots.xy.tolist()]
        names = dots.names or ("",) * len(at)
        colours = dots.colours or (0,) * len(at)
        parts = [
            _dot(x, y, dots.radius, colour, name)
            for (x, y), name, colour in zip(at, names, colours, strict=True)
        ]
        return "".join([*parts, *(_labels(at, names) if dots.is_labelled else [])])

    def _ellipses(self, mark: Ellipses) -> str:
        parts = []
        for outline in mark.outlines():
            points = "L".join(f"{x:.1f} {y:.1f}" for x, y in map(self._pair, outline))
            style = f"stroke:var(--c{mark.colour})"
            parts.append(tag("path", d=f"M{points}Z", class_="ellipse", style=style))
        return "".join(parts)

    def _vectors(self, mark: Vectors) -> str:
        style = f"stroke:var(--c{mark.colour});stroke-width:1.6;fill:none"
        style += f";stroke-opacity:{mark.opacity:.2f}" if mark.opacity < 1 else ""
        across = (WIDTH - LEFT - RIGHT) / (self._x.high - self._x.low)
        up = (HEIGHT - TOP - BOTTOM) / (self._y.high - self._y.low)
        path = "".join(
            f"M{x:.1f} {y:.1f}l{dx * across:.1f} {-dy * up:.1f}"
            for (x, y), (dx, dy) in zip(map(self._pair, mark.at), mark.step.tolist(), strict=True)
        )
        return tag("path", d=path, style=style) if path else ""

    _KINDS: ClassVar[dict[type, Callable[..., str]]] = {
        Line: _line, Steps: _steps, Dots: _dots, Ellipses: _ellipses, Vectors: _vectors,
        Cells: _cells,
    }  # fmt: skip

    def _pair(self, xy: Array) -> tuple[float, float]:
        return self.place(float(xy[0]), float(xy[1]))

    def band(self, line: Line) -> str:
        """Return the band of one standard deviation on both sides of a line."""
        if line.sigma is None:
            return ""
        there = self._path(line.x, line.y + line.sigma)
        back = self._path(line.x[::-1], (line.y - line.sigma)[::-1])
        if not there or not back:
            return ""
        style = f"fill:var(--c{_colour(line)});fill-opacity:0.22;stroke:none"
        return tag("path", d=f"{there}L{back[1:]}Z", style=style, class_="band")

    def dots_of_line(self, line: Line) -> str:
        """Return dots for values that no line joins, and bars of standard errors."""
        lonely = line.is_dotted or len(line.x) == 1
        if not lonely and line.error is None:
            return ""
        parts = []
        errors = np.full(len(line.x), np.nan) if line.error is None else line.error
        for x, y, error in zip(line.x.tolist(), line.y.tolist(), errors.tolist(), strict=True):
            if not self._stands(x, y):
                continue
            paint = f"var(--c{_colour(line)})"
            across, up = (f"{value:.1f}" for value in self.place(x, y))
            if math.isfinite(error):
                low, high = (f"{self.place(x, y + k * error)[1]:.1f}" for k in (-1, 1))
                style = f"stroke:{paint}"
                parts.append(tag("line", x1=across, x2=across, y1=low, y2=high, style=style))
            name = line.label if lonely else ""
            parts.append(_dot(float(across), float(up), 2.6, _colour(line), name))
        return "".join(parts)

    def places(self, mark: Places) -> str:
        """Return a dashed vertical line with its label at each place."""
        at = {label: value for label, value in mark.at.items() if math.isfinite(value)}
        parts = []
        for level, (label, value) in enumerate(at.items()):
            share, x = self._x(value), f"{self._across(value):.1f}"
            parts.append(tag("line", class_="mark", x1=x, x2=x, y1=TOP, y2=HEIGHT - BOTTOM))
            left = share > 0.5
            # Put the label outside the outermost line of its half, so that no line crosses it.
            half = [self._across(v) for v in at.values() if (self._x(v) > 0.5) == left]
            beside = min(half) - 5 if left else max(half) + 5
            parts.append(
                tag("text", escape(label), class_="tick", x=f"{beside:.1f}",
                    y=TOP + 14 + 16 * level, text_anchor="end" if left else "start")
            )  # fmt: skip
        return "".join(parts)

    def _stands(self, x: float, y: float) -> bool:
        """Tell whether a point can be drawn: a logarithmic axis excludes values of 0 and below."""
        return (
            math.isfinite(x) and math.isfinite(y)
            and (x > 0 or not self._x.is_logarithmic) and (y > 0 or not self._y.is_logarithmic)
        )  # fmt: skip

    def _path(self, x: Array, y: Array) -> str:
        pieces, pen = [], "M"
        for a, b in zip(x.tolist(), y.tolist(), strict=True):
            if self._stands(a, b):
                across, up = self.place(a, b)
                pieces.append(f"{pen}{across:.1f} {up:.1f}")
            pen = "L" if self._stands(a, b) else "M"
        return "".join(pieces)


def _dot(x: float, y: float, radius: float, colour: int, name: str = "") -> str:
    title = tag("title", escape(name)) if name else ""
    style = f"fill:var(--c{colour % COLOURS})"
    return tag("circle", title, cx=f"{x:.1f}", cy=f"{y:.1f}", r=f"{radius:g}", style=style)


def _colour(mark: Line | Steps) -> int:
    return (mark.colour or 0) % COLOURS


def _curve(mark: Line | Steps, path: str) -> str:
    title = tag("title", escape(mark.label)) if mark.label else ""
    return tag("path", title, d=path, **_look(mark))


def _look(mark: Line | Steps) -> dict[str, str | None]:
    faint = isinstance(mark, Line) and mark.opacity < 1
    return {
        "class_": "curve faint" if faint else "curve",
        "style": f"stroke:var(--c{_colour(mark)})",
        "stroke_dasharray": DASHES[mark.dash % len(DASHES)],
    }


def _legend(marks: Iterable[Line | Steps]) -> str:
    entries = []
    for mark in marks:
        stroke = tag("path", d="M0 5H30", **_look(mark))
        swatch = tag("svg", stroke, viewBox="0 0 30 10", aria_hidden="true")
        entries.append(tag("li", swatch, escape(mark.label)))
    return tag("ul", *entries, class_="legend")


def _labels(dots: list[tuple[float, float]], names: Iterable[str]) -> list[str]:
    """Return the names that have room next to their dots or above them."""
    taken = [(x - 4, y - 4, x + 4, y + 4) for x, y in dots]
    parts = []
    for (x, y), name in zip(dots, names, strict=True):
        width = LETTER * len(name)
        for left, middle in ((x + 6, y), (x - 6 - width, y), (x - 6, y - 12)):
            box = (left, middle - 7, left + width, middle + 7)
            others = [other for other in taken if other != (x - 4, y - 4, x + 4, y + 4)]
            inside = box[0] > LEFT and box[2] < WIDTH - RIGHT and box[1] > TOP
            if inside and not any(_meet(box, other) for other in others):
                taken.append(box)
                at = {"x": f"{left:.1f}", "y": f"{middle + 4:.1f}"}
                parts.append(tag("text", escape(name), class_="tick", **at))
                break
    return parts


def _meet(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
