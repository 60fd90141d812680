"""Figures of lines, as those of an odometry: a function of a Matplotlib axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bundle.base.arguments import check_type
from bundle.figures.line_figure import LineFigure
from bundle.figures.matplotlib.charts import COLOURS, LINES, legend_below

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_lines"]


def draw_lines(ax: Axes, figure: LineFigure) -> None:
    """Draw a figure of lines, as :func:`bundle.figures.odometry_figures` returns them.

    Raises:
        InputError: ``figure`` is none.
    """
    check_type("figure", figure, LineFigure)
    if figure.is_logarithmic:
        ax.set_yscale("log", nonpositive="mask")
    limits = [line for line in figure.lines if line.is_limit]
    for index, line in enumerate(figure.lines):
        colour = "0.5" if line.is_limit else COLOURS[index % len(COLOURS)]
        style = "none" if line.is_dotted else "-"
        if line.is_limit:
            style = LINES[1 + limits.index(line) % (len(LINES) - 1)]
        mark = "." if line.is_dotted or len(line.x) == 1 else None
        ax.plot(line.x, line.y, style, marker=mark, color=colour, label=line.label, linewidth=1.2)
        if line.sigma is not None:
            low, high = line.y - line.sigma, line.y + line.sigma
            ax.fill_between(line.x, low, high, color=colour, alpha=0.2, linewidth=0)
    ax.set(xlabel=figure.x_label, ylabel=figure.y_label, title=figure.title)
    if figure.is_plan:
        ax.set_aspect("equal", adjustable="datalim")
    if len(figure.lines) > 1:
        legend_below(ax)
