"""Figures as data: axes and marks, for pages and for Matplotlib.

Each renderer implements each mark once: :mod:`bundle.reports.page.svg` for pages,
:mod:`bundle.figures.matplotlib.draw` for Matplotlib. To add a figure, write a function that returns
a :class:`Figure`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.figures.marks import GREY, SHAPE, Axis, Line, Mark, Steps, linear, logarithmic, square

Array = NDArray[np.float64]

NO_AXIS = Axis(0.0, 1.0, ())
"""Axes of bar charts, which have no ranges."""


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
    def legend(self) -> list[Line | Steps]:
        """Return the marks that have a label."""
        return [mark for mark in self.marks if isinstance(mark, Line | Steps) and mark.label]


def over_image(box: Array, name: str, title: str, *marks: Mark, note: str = "") -> Figure:
    """Return a figure over the image plane, with left, top, right, bottom and marks in pixels."""
    left, top, right, bottom = box.tolist()
    x, y = Axis(left, right, (), label="x [px]"), Axis(top, bottom, (), label="y [px]")
    return Figure(name=name, title=title, x=x, y=y, marks=marks, note=note, is_image=True)


@dataclass(frozen=True, eq=False, kw_only=True)
class LineFigure:
    """Figure of lines with one pair of axes.

    Attributes:
        name: one word that identifies the figure for programs.
        title: title of the figure.
        x_label, y_label: labels of the axes, with units.
        lines: lines in the order of the legend.
        is_logarithmic: True for a logarithmic y axis, which excludes values of 0 and below.
        is_plan: True if both axes have the same scale.
        note: sentence below the figure, or "".
    """

    name: str
    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]
    is_logarithmic: bool = False
    is_plan: bool = False
    note: str = ""

    def asdict(self) -> dict[str, Any]:
        """Return the data of the figure for JSON."""
        return {
            "name": self.name,
            "lines": [
                {
                    "label": line.label,
                    "x": line.x.tolist(),
                    "y": line.y.tolist(),
                    "sigma": None if line.sigma is None else line.sigma.tolist(),
                }
                for line in self.lines
            ],
        }

    def figure(self) -> Figure:
        """Return the figure with axes over all lines and bands; limits are grey and dashed."""
        limits = [line for line in self.lines if line.is_limit]
        marks = tuple(
            replace(line, colour=GREY, dash=1 + limits.index(line))
            if line.is_limit
            else replace(line, colour=index if line.colour is None else line.colour)
            for index, line in enumerate(self.lines)
        )
        x = _finite(line.x for line in self.lines)
        bands = [(line.y, line.sigma) for line in self.lines if line.sigma is not None]
        y = _finite(
            [line.y for line in self.lines] + [y + sign * s for y, s in bands for sign in (-1, 1)]
        )
        if self.is_plan and len(x) and len(y):
            axes = _plan(x, y, (self.x_label, self.y_label))
        elif self.is_logarithmic:
            axes = linear(x, self.x_label), logarithmic(y, self.y_label)
        else:
            low = None if (y < 0).any() else 0.0
            axes = linear(x, self.x_label), linear(y, self.y_label, low=low)
        return Figure(
            name=self.name, title=self.title, x=axes[0], y=axes[1], marks=marks, note=self.note,
            is_plan=self.is_plan,
        )  # fmt: skip


def _plan(x: Array, y: Array, labels: tuple[str, str]) -> tuple[Axis, Axis]:
    """Return axes with the same scale in both directions."""
    ends = [(values.min() / 2, values.max() / 2) for values in (x, y)]  # sums could overflow
    middle = [low + high for low, high in ends]
    half = [high - low for low, high in ends]
    reach = max(1.05 * half[0] / SHAPE, 1.05 * half[1], 1e-3)
    return square((middle[0], middle[1]), reach, labels)


def _finite(parts: Iterable[Array]) -> Array:
    """Return the finite values of all arrays."""
    values: Array = np.concatenate([np.zeros(0), *parts])
    return values[np.isfinite(values)]
