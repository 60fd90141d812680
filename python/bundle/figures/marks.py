"""Marks of figures: what stands on a pair of axes, as data.

Coordinates are those of the axes. Colours and dashes are numbers that count from 0 in the palette
and the line styles of each renderer; both repeat.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "GREY",
    "Bars",
    "Cells",
    "Dots",
    "Ellipses",
    "Line",
    "Mark",
    "Photo",
    "Places",
    "StackedBars",
    "Steps",
    "Vectors",
    "direction_colours",
]

Array = NDArray[np.float64]

GREY = 6
"""Number of the grey in the palette."""


@dataclass(frozen=True, eq=False)
class Line:
    """A line through points.

    Attributes:
        label: of the legend; "": none.
        x, y: (n,) each; nan breaks the line.
        sigma: (n,) standard deviations of y, drawn as a band to both sides; None: no band.
        is_limit: a bound, such as a budget: grey and dashed, another one dotted.
        is_dotted: values without a line between them.
        colour: in the palette; None: its place among the lines of the figure.
        dash: line style.
        error: (n,) standard errors of y, drawn as bars at each value; None: none.
    """

    label: str
    x: Array
    y: Array
    sigma: Array | None = None
    is_limit: bool = False
    is_dotted: bool = False
    colour: int | None = None
    dash: int = 0
    error: Array | None = None


@dataclass(frozen=True, eq=False)
class Steps:
    """Stairs.

    Attributes:
        label: of the legend.
        x: (n,) each value holds from its x to the next; or (n + 1,) edges of n bins.
        y: (n,) values.
        colour: in the palette.
        dash: line style.
    """

    label: str
    x: Array
    y: Array
    colour: int = 0
    dash: int = 0


@dataclass(frozen=True, eq=False)
class Places:
    """Vertical lines at named places on the x axis."""

    at: Mapping[str, float]
    colour: int = GREY


@dataclass(frozen=True, eq=False)
class Bars:
    """A bar for each name, on a logarithmic scale.

    Attributes:
        values: by name; nan and 0 have no bar.
        show: writes a value.
        impossible: names of what cannot be, hatched.
        is_ordered: the names are classes of a histogram.
        most: bars beyond these may be folded away; None: none.
    """

    values: Mapping[str, float]
    show: Callable[[float], str]
    impossible: Collection[str] = ()
    is_ordered: bool = False
    most: int | None = None


@dataclass(frozen=True, eq=False)
class StackedBars:
    """A bar for each name, of parts that add up; the part "rest" is grey."""

    rows: Mapping[str, Mapping[str, float]]
    unit: str


@dataclass(frozen=True, eq=False)
class Cells:
    """Equal cells over the axes, the fuller the larger the value.

    Attributes:
        values: (rows, columns); nan: empty.
        top: the value that is drawn full.
        unit: of the values.
        titles: of each cell, row by row; (): none.
        levels: of contours on top.
    """

    values: Array
    top: float
    unit: str
    titles: tuple[str, ...] = ()
    levels: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Vectors:
    """Lines from points, as long as they are to be drawn.

    Attributes:
        at: (n, 2) starts.
        step: (n, 2) ends minus starts.
        colour: in the palette, of those that are bold.
        is_bold: (n,) the others are grey; None: all are.
        cells: (n,) the cell of each, row by row; None: no cells.
        grid: rows and columns of the cells.
        titles: of each cell of the grid, row by row.
    """

    at: Array
    step: Array
    colour: int = 1
    is_bold: NDArray[np.bool_] | None = None
    cells: NDArray[np.int64] | None = None
    grid: tuple[int, int] = (0, 0)
    titles: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Dots:
    """Points.

    Attributes:
        xy: (n, 2).
        colours: (n,) in the palette; () for the first.
        names: of each, shown where a pointer rests; ().
        is_labelled: names also stand beside the points, where there is room.
        directions: (n, 2) vectors whose directions give the colours; None: ``colours`` do.
    """

    xy: Array
    colours: tuple[int, ...] = ()
    names: tuple[str, ...] = ()
    is_labelled: bool = False
    directions: Array | None = None


@dataclass(frozen=True, eq=False)
class Ellipses:
    """Ellipses of one standard deviation about the origin.

    Attributes:
        covariances: (n, 2, 2).
        colour: in the palette.
    """

    covariances: Array
    colour: int = 0

    def outlines(self) -> list[Array]:
        """Return (61, 2) points of each ellipse, closed."""
        around = np.linspace(0, 2 * np.pi, 61)
        unit = np.stack([np.cos(around), np.sin(around)])
        values, vectors = np.linalg.eigh(self.covariances)
        halves = np.sqrt(np.maximum(values, 0.0))
        return [(v @ (h[:, None] * unit)).T for v, h in zip(vectors, halves, strict=True)]


@dataclass(frozen=True, eq=False)
class Photo:
    """A picture over the whole axes.

    Attributes:
        picture: a data: address for a page, what ``imshow`` takes for Matplotlib.
    """

    picture: object = field(repr=False)


Mark = Line | Steps | Places | Bars | StackedBars | Cells | Vectors | Dots | Ellipses | Photo


# Hues of equal lightness and chroma in CIE LCh(ab) (L = 62, C = 38), every 30 degrees from right,
# clockwise as an image is seen; between them, linear in sRGB.
_HUES = np.array(
    [
        (212, 123, 151), (213, 126, 118), (198, 136, 92), (171, 148, 81), (136, 158, 90),
        (95, 164, 115), (40, 167, 149), (0, 167, 182), (3, 162, 207), (98, 153, 217),
        (153, 141, 208), (192, 129, 184),
    ],
    float,
)  # fmt: skip


def direction_colours(vectors: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return (n, 3) colours red, green, blue of the directions of (n, 2) vectors, y down."""
    turn = np.mod(np.arctan2(vectors[:, 1], vectors[:, 0]) / (2 * np.pi), 1.0) * len(_HUES)
    first = np.floor(turn).astype(int) % len(_HUES)
    share = (turn - np.floor(turn))[:, None]
    mixed = (1 - share) * _HUES[first] + share * _HUES[(first + 1) % len(_HUES)]
    colours: NDArray[np.uint8] = np.rint(mixed).astype(np.uint8)
    return colours
