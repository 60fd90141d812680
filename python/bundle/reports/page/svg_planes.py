"""Figures over an image plane as SVG: shaded cells, contours, vectors, dots, photographs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Any, ClassVar

import numpy as np

from bundle.figures.marks import (
    Array,
    Cells,
    Dots,
    Figure,
    Photo,
    Vectors,
    direction_colours,
    short,
)
from bundle.reports.page.page import data_uri, tag

LONGER = 400.0
PAD = 2.0
BELOW = 18.0
DOTS_WIDE = 560


def plane(figure: Figure) -> str:
    """Return a drawing in the shape of the image, with corner coordinates and a legend.

    Its longer side is 400, so that letters keep their size where the page limits the height.
    """
    area = _Plane(figure)
    content = [area.mark(mark) for mark in figure.marks]
    size = {"width": f"{area.width:.1f}", "height": f"{area.height:.1f}"}
    y = f"{area.height + 2 * PAD + 13:.1f}"
    frame = tag("rect", class_="plane", x=PAD, y=PAD, **size)
    corners = [
        tag("text", f"{figure.x.low:.0f}, {figure.y.low:.0f}", class_="tick", x=PAD, y=y),
        tag("text", f"{figure.x.high:.0f}, {figure.y.high:.0f} px", class_="tick",
            x=f"{PAD + area.width:.1f}", y=y, text_anchor="end"),
    ]  # fmt: skip
    view = f"0 0 {area.width + 2 * PAD:.1f} {area.height + 2 * PAD + BELOW:.1f}"
    photographed = any(isinstance(mark, Photo) for mark in figure.marks)
    drawing = tag(
        "svg", frame, *content, *corners, viewBox=view, role="img", aria_label=figure.name,
        preserveAspectRatio="xMinYMid",
        class_="photographed" if photographed else None,
    )  # fmt: skip
    return drawing + "".join(map(scale, figure.marks))


class _Plane:
    """Area of an image; it places marks in the drawing."""

    def __init__(self, figure: Figure) -> None:
        self._corner = np.array([figure.x.low, figure.y.low])
        self._size = np.array([figure.x.high, figure.y.high]) - self._corner
        self.width, self.height = (LONGER * self._size / self._size.max()).tolist()
        self._unit = self.width / float(self._size[0])
        self._photographed = any(isinstance(mark, Photo) for mark in figure.marks)

    def mark(self, mark: Any) -> str:
        """Return the markup of a mark."""
        return self._KINDS[type(mark)](self, mark)

    def _cells(self, mark: Cells) -> str:
        return cells(mark, np.array([PAD, PAD]), (self.width, self.height))

    def _vectors(self, mark: Vectors) -> str:
        start, step = self._places(mark.at), self._unit * mark.step
        if mark.cells is None or mark.is_bold is None:
            path = "".join(
                f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"
                for (x, y), (dx, dy) in zip(start.tolist(), step.tolist(), strict=True)
            )
            casing = tag("path", d=path, class_="casing") if self._photographed else ""
            return casing + tag("path", d=path, class_="residuals") if path else ""
        drawn = []
        for (x, y), (dx, dy), bold, cell in zip(
            start.tolist(), step.tolist(), mark.is_bold, mark.cells, strict=True
        ):
            path = f"M{x:.2f} {y:.2f}l{dx:.2f} {dy:.2f}"
            drawn.append(tag("path", d=path, data_cell=cell, class_="bold" if bold else None))
            drawn.append(tag("circle", cx=f"{x:.1f}", cy=f"{y:.1f}", r=1.2))
        return tag("g", *drawn, class_="vectors") + self._areas(mark)

    def _areas(self, mark: Vectors) -> str:
        rows, columns = mark.grid
        wide, high = self.width / columns, self.height / rows
        areas = []
        for cell, title in enumerate(mark.titles):
            row, column = divmod(cell, columns)
            areas.append(
                tag("rect", tag("title", escape(title)), class_="area",
                    x=f"{PAD + column * wide:.1f}", y=f"{PAD + row * high:.1f}",
                    width=f"{wide:.1f}", height=f"{high:.1f}")
            )  # fmt: skip
        return "".join(areas)

    def _dots(self, mark: Dots) -> str:
        """Return dots as one picture, coloured by direction, because there are thousands."""
        vectors = np.ones((len(mark.xy), 2)) if mark.directions is None else mark.directions
        across, down = DOTS_WIDE, max(round(DOTS_WIDE * self.height / self.width), 1)
        image = np.zeros((down, across, 4), np.uint8)
        share = (mark.xy - self._corner) / self._size
        x = (share[:, 0] * across).astype(int)
        y = (share[:, 1] * down).astype(int)
        colours = direction_colours(vectors)
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                place = np.clip(y + dy, 0, down - 1), np.clip(x + dx, 0, across - 1)
                image[(*place, slice(0, 3))] = colours
                image[(*place, 3)] = 255
        return self._picture(data_uri(image), "dots")

    def _photo(self, mark: Photo) -> str:
        return self._picture(str(mark.picture), None)

    def _picture(self, address: str, kind: str | None) -> str:
        return tag(
            "image", href=address, x=PAD, y=PAD, width=f"{self.width:.1f}",
            height=f"{self.height:.1f}", preserveAspectRatio="none", class_=kind,
        )  # fmt: skip

    _KINDS: ClassVar[dict[type, Callable[..., str]]] = {
        Cells: _cells, Vectors: _vectors, Dots: _dots, Photo: _photo,
    }  # fmt: skip

    def _places(self, xy: Array) -> Array:
        places: Array = PAD + self._unit * (xy - self._corner)
        return places


def cells(mark: Cells, corner: Array, size: tuple[float, float]) -> str:
    """Return cells and contours over an area with its (2,) top left corner, width and height."""
    rows, columns = mark.values.shape
    wide, high = size[0] / columns, size[1] / rows
    left, top = corner.tolist()
    drawn = []
    for cell, value in enumerate(mark.values.ravel().tolist()):
        if not np.isfinite(value):
            continue
        row, column = divmod(cell, columns)
        share = min(value / mark.top, 1.0) if mark.top > 0 else 0.0
        title = tag("title", escape(mark.titles[cell])) if mark.titles else ""
        drawn.append(
            tag("rect", title, data_cell=cell, x=f"{left + column * wide:.1f}",
                y=f"{top + row * high:.1f}", width=f"{wide + 0.2:.1f}",
                height=f"{high + 0.2:.1f}", fill_opacity=f"{share:.3f}")
        )  # fmt: skip
    lines = contours(mark.values, mark.levels, (wide, high), corner) if mark.levels else ""
    return tag("g", *drawn, class_="heat") + lines


def scale(mark: Any) -> str:
    """Return what the colours of a mark mean; empty for a mark without a scale of colours."""
    if isinstance(mark, Cells):
        words = f"{short(float(f'{mark.top:.3g}'))} {mark.unit}".strip()
        ends = [tag("span", "0"), tag("span", class_="ramp"), tag("span", escape(words))]
        return tag("p", *ends, class_="scale")
    if not isinstance(mark, Dots) or mark.directions is None:
        return ""
    parts = []
    for index, name in enumerate(("right", "down", "left", "up")):
        angle = 0.5 * np.pi * index
        red, green, blue = direction_colours(np.array([[np.cos(angle), np.sin(angle)]]))[0]
        colour = f"background:rgb({red},{green},{blue})"
        parts.append(tag("li", tag("span", class_="swatch", style=colour), name))
    return tag("ul", *parts, class_="legend")


# Contours of values over the cells of an image plane, by marching squares.
#
# Each value belongs to the middle of a cell. The middles of four neighbouring cells form a square;
# each corner is above or below the level. The contour joins sides of the square, at the positions
# where linear interpolation gives the level. If opposite corners are above (a saddle), the mean of
# the four values decides which sides are joined.

CORNERS = np.array([(0.5, 0.5), (1.5, 0.5), (1.5, 1.5), (0.5, 1.5)])
"""Middles of the four cells of the first square, clockwise from top left."""

TURN = 2.4  # angle in radians between the labels of successive contours, about the golden angle

# Sides are 0 top, 1 right, 2 bottom, 3 left; corners count 1, 2, 4, 8 clockwise from top left.
_SIDES: dict[int, tuple[tuple[int, int], ...]] = {
    1: ((3, 0),), 2: ((0, 1),), 3: ((3, 1),), 4: ((1, 2),), 6: ((0, 2),), 7: ((3, 2),),
    8: ((2, 3),), 9: ((0, 2),), 11: ((1, 2),), 12: ((1, 3),), 13: ((0, 1),), 14: ((3, 0),),
}  # fmt: skip
_SADDLES = {
    (5, True): ((0, 1), (2, 3)), (5, False): ((3, 0), (1, 2)),
    (10, True): ((3, 0), (1, 2)), (10, False): ((0, 1), (2, 3)),
}  # fmt: skip


def contour(values: Array, level: float) -> Array:
    """Return (n, 2, 2) segments, ends as (x, y) in cells; the first cell's middle is (0.5, 0.5).

    Squares with a value that is not finite have no segments.
    """
    corners = np.stack([values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1]])
    known = np.isfinite(corners).all(axis=0)
    above = (corners > level) & known
    case = (above * np.array([1, 2, 4, 8])[:, None, None]).sum(axis=0)
    segments = []
    for row, column in np.argwhere(known & (case > 0) & (case < 15)):
        four = corners[:, row, column]
        kind = int(case[row, column])
        pairs = _SIDES.get(kind) or _SADDLES[kind, bool(four.mean() > level)]
        places = CORNERS + np.array([column, row])
        for pair in pairs:
            ends = []
            for side in pair:
                a, b = side, (side + 1) % 4
                share = (level - four[a]) / (four[b] - four[a])
                ends.append(places[a] + share * (places[b] - places[a]))
            segments.append(ends)
    return np.array(segments).reshape(-1, 2, 2)


def contours(
    values: Array, levels: Sequence[float], cell: tuple[float, float], corner: Array
) -> str:
    """Return contours with labels of their levels; values are those in the middles of cells.

    ``cell`` is the width and height of a cell, ``corner`` the top left corner of the first.
    """
    rows, columns = values.shape
    middle = np.array([columns, rows]) / 2
    lines, labels, taken = [], [], np.zeros((0, 2))
    for index, level in enumerate(levels):
        segments = contour(values, level)
        if not len(segments):
            continue
        ends = corner + segments * cell
        path = "".join(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" for a, b in ends)
        lines.append(tag("path", d=path, data_level=f"{level:g}"))
        # Spread the labels around the middle, so that labels of neighbours do not overlap.
        towards = np.array([np.cos(TURN * index), np.sin(TURN * index)])
        offset = segments.mean(axis=1) - middle
        along = offset @ towards / np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
        x, y = ends.mean(axis=1)[int(np.argmax(along))]
        inside = np.array([18, 10])
        x, y = np.clip([x, y], corner + inside, corner + 2 * middle * cell - inside)
        if (np.abs(taken - [x, y]) < [40, 14]).all(axis=1).any():
            continue
        taken = np.vstack([taken, [x, y]])
        words = escape(f"{level:g}")
        labels.append(tag("text", words, x=f"{x:.1f}", y=f"{y + 4:.1f}", text_anchor="middle"))
    return tag("g", *lines, *labels, class_="contours")
