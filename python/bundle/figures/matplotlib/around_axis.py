"""Names around a Matplotlib axis: title, names of rows, note and legend, and the room for them."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Place = Literal["center", "right"]
AT: dict[Place, float] = {"center": 0.5, "right": 1.0}

SMALL = 7.0  # font size of names of rows and curves, in points like the next three
LINE = 1.5 * SMALL
TITLE_ABOVE = 24.0
LABELS_BELOW = 38.0  # ticks and label
# Characters per inch: of a title, of labels in two columns, of a label line on an axis narrower
# than WIDE, and of a note.
TITLE, OF_TWO, OF_A_LINE, OF_A_NOTE = 11.0, 5.5, 10.5, 8.0
WIDE = 4.0  # inches: on wider axes, labels have one line
MOST_WRAPPED = 4  # number of long names of rows that are wrapped; more stay in one line
LONGEST_LINE = 36  # characters of a name in one line
LEAST_SHARE = 0.75  # of the requested height remains for the axis; beyond that, the figure grows


def show_title(ax: Axes, name: str, place: Place = "center") -> None:
    """Draw a title. Long titles are cut at the beginning, because file names differ at the end."""
    longest = max(round(TITLE * _inches(ax)), 10)
    shown = name if len(name) <= longest else "..." + name[3 - longest :]
    ax.set_title(shown, loc=place, fontsize=9, parse_math=False)


def name_rows(ax: Axes, names: list[str]) -> None:
    """Write the names of horizontal bars, the first on top."""
    long = [len(name) for name in names if len(name) > 22]
    two_lines = len(long) <= MOST_WRAPPED or max(long) > LONGEST_LINE
    shown = [*map(_wrapped, names)] if two_lines else names
    ax.set_yticks(np.arange(len(names)), shown, fontsize=SMALL)
    ax.set_ylim(len(names) - 0.4, -0.6)


def note_below(ax: Axes, note: str, place: Place = "center") -> float:
    """Write a note below an axis and its label; return the height of its lines in points."""
    lines = textwrap.wrap(note, max(round(OF_A_NOTE * _inches(ax)), 20))
    ax.annotate(
        "\n".join(lines), (AT[place], 0.0), (0, -LABELS_BELOW), xycoords="axes fraction",
        textcoords="offset points", ha=place, va="top", fontsize=SMALL, parse_math=False,
    )  # fmt: skip
    return LINE * len(lines) + 4


def legend_below(ax: Axes, below: float = 0.0, place: Place = "center") -> float:
    """Put the legend below the axis, its label and ``below`` points, where it hides no curve.

    Returns:
        Its height in points.
    """
    from matplotlib.transforms import offset_copy  # not installed with bundle

    handles, names = ax.get_legend_handles_labels()
    inches = _inches(ax)
    two_fit = max(map(len, names), default=0) <= OF_TWO * inches
    if inches < WIDE and not two_fit:
        names = [_wrapped(name, round(OF_A_LINE * inches)) for name in names]
    ax.legend(
        handles,
        names,
        fontsize=SMALL,
        loc="upper right" if place == "right" else "upper center",
        bbox_to_anchor=(AT[place], 0.0),
        bbox_transform=offset_copy(
            ax.transAxes, ax.get_figure(root=True), y=-LABELS_BELOW - below, units="points"
        ),
        borderaxespad=0.0,
        ncols=2 if two_fit else 1,
    )
    lines: int = sum(name.count("\n") + 1 for name in names)
    return LINE * (lines / (2 if two_fit else 1) + 1)


def keep_room(ax: Axes, below: float, named_rows: bool) -> None:
    """Make a figure of one axis so high that all names fit.

    Args:
        ax: the only axis; a figure with several axes keeps its height.
        below: height of note and legend, in points.
        named_rows: True if the ticks of y are names of rows, which need a line each.
    """
    made = ax.get_figure(root=True)
    if made is None or len(made.axes) > 1:
        return
    height = 72 * made.get_figheight()
    least = LEAST_SHARE * height
    if named_rows:
        names = [label.get_text() for label in ax.get_yticklabels()]
        lines = max((name.count("\n") + 1 for name in names), default=1)
        least = max(least, LINE * lines * len(names))
    whole = TITLE_ABOVE + least + LABELS_BELOW + below
    if below + named_rows and height < whole:
        made.set_figheight(whole / 72)


def _inches(ax: Axes) -> float:
    """Return the width of an axis in inches, including the labels around it."""
    spec = ax.get_subplotspec()
    columns = 1 if spec is None else spec.get_gridspec().ncols
    return float(ax.get_figure(root=True).get_figwidth()) / columns  # type: ignore[union-attr]


def _wrapped(name: str, width: int = 22) -> str:
    """Return a name wrapped into short lines."""
    return textwrap.fill(name, width, break_long_words=False, break_on_hyphens=False)
