"""A figure of lines as numbers, for whatever draws it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Line", "LineFigure"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Line:
    """A line of a figure.

    Attributes:
        label: of the legend.
        x, y: (n,) each; nan breaks the line.
        sigma: (n,) standard deviations of y, drawn as a band to both sides; None: no band.
        is_limit: a bound, such as a budget: grey and dashed, another one dotted.
        is_dotted: values without a line between them.
    """

    label: str
    x: Array
    y: Array
    sigma: Array | None = None
    is_limit: bool = False
    is_dotted: bool = False


@dataclass(frozen=True, eq=False, kw_only=True)
class LineFigure:
    """A figure of lines over one pair of axes.

    Attributes:
        name: one word, by which programs tell figures apart.
        title: of the figure.
        x_label, y_label: of the axes, with units.
        lines: in the order of the legend.
        is_logarithmic: the y axis is; values of 0 and below have no place on it.
        is_plan: both axes have the same scale.
        note: a sentence below the figure, or nothing.
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
        """Return the numbers for JSON."""
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
