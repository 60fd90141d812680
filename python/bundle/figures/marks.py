"""Figures as data: axes and marks, for pages and for Matplotlib.

Each renderer implements each mark once: :mod:`bundle.reports.page.svg` for pages,
:mod:`bundle.figures.matplotlib.draw` for Matplotlib. To add a figure, write a function that
returns a :class:`Figure`.

Coordinates are those of the axes. Colours and dashes are indices into the palette and the line
styles of each renderer, from 0; indices beyond the end start again at 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.records import dataclass

Array = NDArray[np.float64]

GREY = 6  # index of grey in the palette


@dataclass(frozen=True, eq=False)
class Line:
    """Line through points."""

    label: str  # label in the legend; "": none. x, y: (n,) each; NaN interrupts the line.
    x: Array
    y: Array
    # (n,) standard deviations of y, drawn as a band on both sides; None: no band
    sigma: Array | None = None
    # True for a bound, such as a budget: grey and dashed, a second bound dotted
    is_limit: bool = False
    is_dotted: bool = False  # True for values without a line between them
    colour: int | None = None  # index in the palette; None: position among the lines of the figure
    dash: int = 0  # line style
    # (n,) standard errors of y, drawn as bars at each value; None: no bars
    error: Array | None = None
    opacity: float = 1.0  # opacity of the line, for many lines on top of each other


@dataclass(frozen=True, eq=False)
class Steps:
    """Step function: each value holds from its x to the next; n + 1 x are edges of n bins."""

    label: str
    x: Array
    y: Array
    colour: int = 0
    dash: int = 0


@dataclass(frozen=True, eq=False)
class Places:
    """Vertical lines at named positions on the x axis."""

    at: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Bars:
    """One horizontal bar per name, on a logarithmic scale; NaN and 0 have no bar.

    ``impossible`` bars are hatched. In an ordered histogram, empty classes have no row. Bars after
    the first ``most`` may be folded away.
    """

    values: Mapping[str, float]
    show: Callable[[float], str]
    impossible: Collection[str] = ()
    is_ordered: bool = False
    most: int | None = None

    def rows(self) -> dict[str, float]:
        """Return the values that have a row."""
        if not self.is_ordered:
            return dict(self.values)
        return {name: value for name, value in self.values.items() if value}

    @property
    def scale(self) -> Axis:
        """Axis of the lengths; the smallest value has a visible bar."""
        known = [*self.values.values()]
        return logarithmic([value / 3 for value in known] + known)

    def text(self, name: str) -> str:
        """Return the words beside a bar."""
        value = self.values[name]
        words = self.show(value) if math.isfinite(value) and value > 0 else "none"
        return words + (", does not fit" if name in self.impossible else "")


@dataclass(frozen=True, eq=False)
class StackedBars:
    """One stacked bar per name; the part named "rest" is grey."""

    rows: Mapping[str, Mapping[str, float]]
    unit: str


@dataclass(frozen=True, eq=False)
class Cells:
    """Grid of equal cells over the axes; larger values are more opaque, up to ``top``.

    Values are (rows, columns), NaN for an empty cell; titles go row by row, and levels are those of
    contours on top.
    """

    values: Array
    top: float
    unit: str
    titles: tuple[str, ...] = ()
    levels: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Vectors:
    """Lines from (n, 2) points by (n, 2) steps, drawn at their given length.

    Lines with False in ``bold`` are grey; None: all are bold. ``cells`` has the cell of each line,
    row by row, of a grid of rows and columns with titles. Opacity holds for lines without cells.
    """

    at: Array
    step: Array
    colour: int = 1
    is_bold: NDArray[np.bool_] | None = None
    cells: NDArray[np.int64] | None = None
    grid: tuple[int, int] = (0, 0)
    titles: tuple[str, ...] = ()
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Dots:
    """Dots at (n, 2) points, with their names as tooltips.

    Names are written beside the dots where there is room if ``is_labelled``. The directions of (n,
    2) vectors select the colours in place of ``colours``. The radius is relative to a chart that is
    480 wide.
    """

    xy: Array
    colours: tuple[int, ...] = ()
    names: tuple[str, ...] = ()
    is_labelled: bool = False
    directions: Array | None = None
    radius: float = 3.4


@dataclass(frozen=True, eq=False)
class Ellipses:
    """Ellipses of one standard deviation about the origin, of (n, 2, 2) covariances."""

    covariances: Array
    colour: int = 0

    def outlines(self) -> list[Array]:
        """Return the closed outline of each ellipse, (61, 2) points."""
        around = np.linspace(0, 2 * np.pi, 61)
        unit = np.stack([np.cos(around), np.sin(around)])
        values, vectors = np.linalg.eigh(self.covariances)
        halves = np.sqrt(np.maximum(values, 0.0))
        return [(v @ (h[:, None] * unit)).T for v, h in zip(vectors, halves, strict=True)]


@dataclass(frozen=True, eq=False)
class Photo:
    """Picture over the axes: a data URI for a page, an argument of ``imshow`` for Matplotlib."""

    picture: object = field(repr=False)


@dataclass(frozen=True, eq=False)
class Matrix:
    """Correlation matrix, (n, n) from -1 to 1, with the names of its rows and columns."""

    names: tuple[str, ...]
    values: Array

    def texts(self) -> list[list[str]]:
        """Return the text of each cell, row by row."""
        return [[f"{value:+.3f}" for value in row] for row in self.values.tolist()]


Mark = (
    Line | Steps | Places | Bars | StackedBars | Cells | Vectors | Dots | Ellipses | Photo | Matrix
)


# Hues of equal lightness and chroma in CIE LCh(ab) (L = 62, C = 38), every 30 degrees, clockwise in
# the image, starting to the right. Between them, colours are interpolated linearly in sRGB.
_HUES = np.array(
    [
        (212, 123, 151), (213, 126, 118), (198, 136, 92), (171, 148, 81), (136, 158, 90),
        (95, 164, 115), (40, 167, 149), (0, 167, 182), (3, 162, 207), (98, 153, 217),
        (153, 141, 208), (192, 129, 184),
    ],
    float,
)  # fmt: skip


def direction_colours(vectors: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return (n, 3) red, green, blue for the directions of (n, 2) vectors, y down."""
    turn = np.mod(np.arctan2(vectors[:, 1], vectors[:, 0]) / (2 * np.pi), 1.0) * len(_HUES)
    first = np.floor(turn).astype(int) % len(_HUES)
    share = (turn - np.floor(turn))[:, None]
    mixed = (1 - share) * _HUES[first] + share * _HUES[(first + 1) % len(_HUES)]
    colours: NDArray[np.uint8] = np.rint(mixed).astype(np.uint8)
    return colours


MOST_TICKS = 6
LARGEST = 308  # exponent of the largest power of ten that a double can hold

SHAPE = 410 / 266
"""Ratio of width to height of a chart: (480 - 58 - 12) / (320 - 10 - 44) on a page."""


@dataclass(frozen=True)
class Axis:
    """Axis from ``low`` to ``high`` with its ticks; positions go from 0 to 1."""

    low: float
    high: float
    ticks: tuple[float, ...]
    is_logarithmic: bool = False
    label: str = ""

    def __call__(self, value: float) -> float:
        """Return the position of a value, 0 at ``low`` and 1 at ``high``, limited to 0 to 1."""
        if self.is_logarithmic:
            value, low, high = (math.log(max(x, 1e-300)) for x in (value, self.low, self.high))
        else:  # halve both: the difference of large numbers would overflow
            value, low, high = value / 2, self.low / 2, self.high / 2
        return min(max((value - low) / (high - low), 0.0), 1.0)


def linear(values: Iterable[float], label: str = "", *, low: float | None = 0.0) -> Axis:
    """Return an axis over the finite values with round ticks; ``low`` None: from the smallest."""
    finite = [value for value in values if math.isfinite(value)]
    start = min(finite, default=0.0) if low is None else low
    end = max([*finite, start])
    rough = end / (MOST_TICKS - 1) - start / (MOST_TICKS - 1)
    if rough <= max(1e-300, 1e-14 * abs(start)):  # equal up to rounding errors
        end = start + max(1.0, 1e-9 * abs(start))
        rough = end / (MOST_TICKS - 1) - start / (MOST_TICKS - 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next((power * factor for factor in (1, 2, 5, 10) if power * factor >= rough), rough)
    first, last = math.ceil(start / step - 1e-9), math.floor(end / step + 1e-9)
    return Axis(start, end, tuple(step * k for k in range(first, last + 1)), label=label)


def logarithmic(values: Iterable[float], label: str = "") -> Axis:
    """Return an axis over the positive finite values, with powers of ten at its ends."""
    finite = [value for value in values if math.isfinite(value) and value > 0]
    first = math.floor(math.log10(min(finite, default=1.0)) + 1e-9)
    first = min(max(first, -LARGEST + 1), LARGEST - 1)
    last = min(math.ceil(math.log10(max(finite, default=1.0)) - 1e-9), LARGEST)
    last = max(last, first + 1)
    step = math.ceil((last - first) / MOST_TICKS)
    ticks = tuple(10.0**power for power in range(first, last + 1, step))
    return Axis(10.0**first, 10.0**last, ticks, is_logarithmic=True, label=label)


def square(
    low: ArrayLike, high: ArrayLike, labels: tuple[str, str], margin: float = 0.05
) -> tuple[Axis, Axis]:
    """Return axes of equal scale on a chart that contain a box, with a margin on each side."""
    low, high = (np.asarray(end, float) / 2 for end in (low, high))  # sums could overflow
    across, up = ((1 + margin) * (high - low)).tolist()
    reach = max(across / SHAPE, up, 1e-9)
    x, y = (
        linear([middle - half, middle + half], label, low=None)
        for middle, half, label in zip(low + high, (reach * SHAPE, reach), labels, strict=True)
    )
    return x, y


def round_down(value: float, slack: float = 1e-12) -> float:
    """Return the largest 1, 2 or 5 times a power of ten up to a value; 1 if it is not positive.

    The result may exceed the value by the share ``slack``.
    """
    if not math.isfinite(value) or value <= 0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return max(k * power for k in (1, 2, 5, 10) if k * power <= value * (1 + slack))


def short(value: float) -> str:
    """Return a short text for a number: 0.01, 250, 12k, 3M, 1e-7."""
    size = abs(value)
    if size == 0 or 1e-3 <= size < 1e4:
        return f"{value:.4g}"
    for limit, letter in ((1e6, "k"), (1e9, "M")):
        if 1e4 <= size < limit:
            return f"{value * 1e3 / limit:.4g}{letter}"
    mantissa, _, exponent = f"{value:.1e}".partition("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


NO_AXIS = Axis(0.0, 1.0, ())  # axes of bar charts, which have no ranges


@dataclass(frozen=True, eq=False, kw_only=True)
class Figure:
    """Figure with one pair of axes.

    Attributes:
        name: name that identifies the figure for programs and screen readers.
        title: text above the figure.
        x, y: axes, with labels and units.
        marks: marks in the order of the legend.
        note: text below the figure; "": none.
        is_image: True for a figure over an image: y points down, both axes have the same scale.
        is_plan: True if both axes have the same scale.
    """

    name: str
    title: str
    marks: tuple[Mark, ...]
    x: Axis = NO_AXIS
    y: Axis = NO_AXIS
    note: str = ""
    is_image: bool = False
    is_plan: bool = False

    @property
    def lines(self) -> list[Line]:
        """Return the lines."""
        return [mark for mark in self.marks if isinstance(mark, Line)]

    @property
    def legend(self) -> list[Line | Steps]:
        """Return the marks that have a label."""
        return [mark for mark in self.marks if isinstance(mark, Line | Steps) and mark.label]


def over_image(box: Array, name: str, title: str, *marks: Mark, note: str = "") -> Figure:
    """Return a figure over the image plane, with left, top, right, bottom and marks in pixels."""
    left, top, right, bottom = box.tolist()
    x, y = Axis(left, right, (), label="x [px]"), Axis(top, bottom, (), label="y [px]")
    return Figure(name=name, title=title, x=x, y=y, marks=marks, note=note, is_image=True)


def line_figure(
    name: str,
    title: str,
    x_label: str,
    y_label: str,
    lines: Iterable[Line],
    *,
    is_logarithmic: bool = False,
    is_plan: bool = False,
    note: str = "",
) -> Figure:
    """Return a figure with axes over all lines and bands; limits are grey and dashed.

    Args:
        name: one word that identifies the figure for programs.
        title: title of the figure.
        x_label: label of the x axis, with its unit.
        y_label: label of the y axis, with its unit.
        lines: lines in the order of the legend.
        is_logarithmic: True for a logarithmic y axis, which excludes values of 0 and below.
        is_plan: True if both axes have the same scale.
        note: sentence below the figure, or "".
    """
    lines = tuple(lines)
    limits = [line for line in lines if line.is_limit]
    marks = tuple(
        replace(line, colour=GREY, dash=1 + limits.index(line))
        if line.is_limit
        else replace(line, colour=index if line.colour is None else line.colour)
        for index, line in enumerate(lines)
    )
    x = _finite(line.x for line in lines)
    bands = [(line.y, line.sigma) for line in lines if line.sigma is not None]
    y = _finite([line.y for line in lines] + [y + sign * s for y, s in bands for sign in (-1, 1)])
    if is_plan and len(x) and len(y):
        axes = square((x.min(), y.min()), (x.max(), y.max()), (x_label, y_label))
    elif is_logarithmic:
        axes = linear(x, x_label), logarithmic(y, y_label)
    else:
        axes = linear(x, x_label), linear(y, y_label, low=None if (y < 0).any() else 0.0)
    return Figure(
        name=name, title=title, x=axes[0], y=axes[1], marks=marks, note=note, is_plan=is_plan
    )


def _finite(parts: Iterable[Array]) -> Array:
    values: Array = np.concatenate([np.zeros(0), *parts])
    return values[np.isfinite(values)]
