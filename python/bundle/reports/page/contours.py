"""Contours of values over the cells of an image plane, by marching squares.

Each value belongs to the middle of a cell. The middles of four neighbouring cells form a square;
each corner is above or below the level. The contour joins sides of the square, at the positions
where linear interpolation gives the level. If opposite corners are above (a saddle), the mean of
the four values decides which sides are joined.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from bundle.reports.page.page import tag

Array = NDArray[np.float64]

CORNERS = np.array([(0.5, 0.5), (1.5, 0.5), (1.5, 1.5), (0.5, 1.5)])
"""Middles of the four cells of the first square, clockwise from top left."""

TURN = 2.4
"""Angle in radians between the labels of successive contours, about the golden angle."""

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


def contours(values: Array, levels: Sequence[float], cell: tuple[float, float], pad: float) -> str:
    """Return contours with labels of their levels.

    Args:
        values: (rows, columns) in the middles of cells.
        levels: levels to draw.
        cell: width and height of a cell in the drawing.
        pad: margin to the left of the first cell and above it.
    """
    rows, columns = values.shape
    middle = np.array([columns, rows]) / 2
    lines, labels = [], []
    for index, level in enumerate(levels):
        segments = contour(values, level)
        if not len(segments):
            continue
        ends = pad + segments * cell
        path = "".join(f"M{a[0]:.1f} {a[1]:.1f}L{b[0]:.1f} {b[1]:.1f}" for a, b in ends)
        lines.append(tag("path", d=path, data_level=f"{level:g}"))
        # Spread the labels around the middle, so that labels of neighbours do not overlap.
        towards = np.array([np.cos(TURN * index), np.sin(TURN * index)])
        offset = segments.mean(axis=1) - middle
        along = offset @ towards / np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
        x, y = ends.mean(axis=1)[int(np.argmax(along))]
        width, height = np.array([columns, rows]) * cell
        x, y = np.clip([x, y], [pad + 18, pad + 10], [pad + width - 18, pad + height - 10])
        words = escape(f"{level:g}")
        labels.append(tag("text", words, x=f"{x:.1f}", y=f"{y + 4:.1f}", text_anchor="middle"))
    return tag("g", *lines, *labels, class_="contours")
