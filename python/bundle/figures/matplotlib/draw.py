"""Drawing of figures on a Matplotlib axis, with the ranges, colours and legends of a page."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from bundle.errors import InputError
from bundle.figures.marks import (
    GREY,
    Bars,
    Cells,
    Dots,
    Ellipses,
    Figure,
    Line,
    Matrix,
    Photo,
    Places,
    StackedBars,
    Steps,
    Vectors,
    direction_colours,
)
from bundle.interface.option_fields import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as MatplotlibFigure

# Okabe and Ito's colours, which colour-blind readers can distinguish, then three tinted greys, as
# dark as on a page with a white background.
COLOURS = (
    "#0072b2", "#d55e00", "#008a64", "#b5568d", "#b87f00", "#3a9bd0", "#5b5b5b", "#7a5aa6",
    "#8a5a20", "#2f7f77",
)  # fmt: skip
DASHES = ("-", "--", ":", "-.")


def figure(
    num_rows: int = 1, num_columns: int = 1, *, width: float = 4.0, height: float = 4.0
) -> tuple[MatplotlibFigure, Any]:
    """Return a figure and its (num_rows, num_columns) axes, each ``width`` by ``height`` inches.

    ``width=3.4`` fits a column of most two-column papers. If one axis has names of many curves or
    rows, the figure becomes higher than ``height``, so that the axis stays legible.

    The figure belongs to no window and no global state. ``figure.savefig("a.svg")`` writes PNG or
    SVG, depending on the suffix.

    Raises:
        InputError: Matplotlib is not installed.
    """
    try:
        import matplotlib.figure  # not installed with bundle
    except ImportError:
        raise InputError(
            "pictures: expected Matplotlib, found none; install it with pip install matplotlib"
        ) from None
    num_rows = number("num_rows", num_rows, whole=True, minimum=1, maximum=100)
    num_columns = number("num_columns", num_columns, whole=True, minimum=1, maximum=100)
    width = number("width", width, above=0, maximum=1000)
    height = number("height", height, above=0, maximum=1000)
    made = matplotlib.figure.Figure(
        figsize=(num_columns * width, num_rows * height), layout="constrained"
    )
    made.set_layout_engine("constrained", w_pad=0.08, h_pad=0.08)
    axes = made.subplots(num_rows, num_columns, squeeze=False)
    if width < WIDE:  # a column of a paper
        for ax in axes.flat:
            ax.tick_params(labelsize=8)
            ax.xaxis.label.set_size(8)
            ax.yaxis.label.set_size(8)
    return made, axes


def draw(ax: Axes, figure: Figure, title: str | None = None) -> None:
    """Draw a figure; a long title is cut at its beginning."""
    if not any(isinstance(mark, _WITHOUT_AXES) for mark in figure.marks):
        _set_axes(ax, figure)
    for mark in figure.marks:
        _KINDS[type(mark)](ax, mark)
    named_rows = any(isinstance(mark, Bars | StackedBars) for mark in figure.marks)
    place: Place = "right" if named_rows else "center"  # an axis beside names is narrow
    show_title(ax, figure.title if title is None else title, place)
    below = note_below(ax, figure.note, place) if figure.note else 0.0
    if figure.legend or any(isinstance(mark, StackedBars) and mark.rows for mark in figure.marks):
        below += legend_below(ax, below, place)
    keep_room(ax, below, named_rows)


def _set_axes(ax: Axes, figure: Figure) -> None:
    for axis, set_scale in ((figure.x, ax.set_xscale), (figure.y, ax.set_yscale)):
        if axis.is_logarithmic:
            set_scale("log", nonpositive="mask")
    y = (figure.y.high, figure.y.low) if figure.is_image else (figure.y.low, figure.y.high)
    ax.set(xlim=(figure.x.low, figure.x.high), ylim=y)
    ax.set(xlabel=figure.x.label, ylabel=figure.y.label)
    if figure.is_image or figure.is_plan:
        ax.set_aspect("equal", adjustable="box")
    else:
        ax.grid(which="major", color="0.9")


def _line(ax: Axes, line: Line) -> None:
    colour = _paint(line.colour or 0)
    style = "none" if line.is_dotted else DASHES[line.dash % len(DASHES)]
    lonely = line.is_dotted or len(line.x) == 1 or line.error is not None
    name = line.label or "_nolegend_"
    ax.plot(
        line.x, line.y, style, marker="." if lonely else None, color=colour, label=name,
        linewidth=1.2, alpha=line.opacity,
    )  # fmt: skip
    if line.sigma is not None:
        low, high = line.y - line.sigma, line.y + line.sigma
        ax.fill_between(line.x, low, high, color=colour, alpha=0.22, linewidth=0)
    if line.error is not None:
        known = np.isfinite(line.error)
        low, high = (line.y[known] + sign * line.error[known] for sign in (-1, 1))
        ax.vlines(line.x[known], low, high, color=colour, linewidth=1)


def _steps(ax: Axes, steps: Steps) -> None:
    look: dict[str, Any] = {
        "label": steps.label or "_nolegend_", "color": _paint(steps.colour),
        "linestyle": DASHES[steps.dash % len(DASHES)], "linewidth": 1.4,
    }  # fmt: skip
    if len(steps.x) > len(steps.y):
        ax.stairs(steps.y, steps.x, **look)
    else:
        lonely = "." if len(steps.x) == 1 else None
        ax.step(steps.x, steps.y, where="post", marker=lonely, **look)


def _places(ax: Axes, mark: Places) -> None:
    low, high = ax.get_xlim()
    for level, (label, value) in enumerate(mark.at.items()):
        ax.axvline(value, color=_paint(GREY), linestyle=":", linewidth=1)
        side = "right" if value > (low + high) / 2 else "left"
        shift = (-3 if side == "right" else 3, -3 - 8 * level)
        ax.annotate(
            label, (value, 1), shift, xycoords=("data", "axes fraction"),
            textcoords="offset points", va="top", ha=side, fontsize=7, parse_math=False,
        )  # fmt: skip


def _bars(ax: Axes, mark: Bars) -> None:
    rows, scale = mark.rows(), mark.scale
    ax.set_xscale("log")
    for place, (name, value) in enumerate(rows.items()):
        known = np.isfinite(value) and value > 0
        end = value if known else scale.low
        (bar,) = ax.barh([place], end - scale.low, left=scale.low, color=_paint(0))
        if name in mark.impossible:
            bar.set(facecolor="none", edgecolor=_paint(1), hatch="////")
        ax.annotate(
            mark.text(name).replace(", ", "\n"), (end, place), (3, 0),
            textcoords="offset points", va="center", fontsize=7, parse_math=False,
        )  # fmt: skip
    ax.set_xlim(scale.low, scale.high * (scale.high / scale.low) ** 0.5)  # room for text
    name_rows(ax, [*rows])


def _stacked_bars(ax: Axes, mark: StackedBars) -> None:
    left = np.zeros(len(mark.rows))
    parts = [*mark.rows.values()]
    for index, phase in enumerate(parts[0] if parts else ()):
        lengths = np.array([part[phase] for part in parts])
        colour = _paint(index) if phase != "rest" else "0.75"
        ax.barh(np.arange(len(parts)), lengths, left=left, label=phase, color=colour)
        left += lengths
    name_rows(ax, [*mark.rows])


def _cells(ax: Axes, mark: Cells) -> None:
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    high = mark.top if mark.top > 0 else 1.0
    image = ax.imshow(
        mark.values, extent=(left, right, bottom, top), cmap="Blues", vmin=0, vmax=high
    )
    ax.figure.colorbar(image, ax=ax, label=mark.unit, shrink=0.8)
    if mark.levels:
        rows, columns = mark.values.shape
        x = left + (np.arange(columns) + 0.5) * (right - left) / columns
        y = top + (np.arange(rows) + 0.5) * (bottom - top) / rows
        lines = ax.contour(x, y, mark.values, mark.levels, colors="black", linewidths=0.7)
        ax.clabel(lines, fontsize=7)


def _vectors(ax: Axes, mark: Vectors) -> None:
    if mark.is_bold is None:
        from matplotlib.collections import LineCollection

        ends = np.stack([mark.at, mark.at + mark.step], axis=1)
        lines = LineCollection(
            [*ends], colors=_paint(mark.colour), linewidths=0.8, alpha=mark.opacity
        )
        ax.add_collection(lines, autolim=False)
        return
    colours = np.where(mark.is_bold, _paint(mark.colour), _paint(6))
    ax.quiver(
        *mark.at.T, *mark.step.T, color=colours, angles="xy", scale_units="xy", scale=1,
        width=0.003, headwidth=0, headlength=0, headaxislength=0,
    )  # fmt: skip
    ax.scatter(mark.at[:, 0], mark.at[:, 1], s=1.5, color=_paint(6), linewidths=0)


def _dots(ax: Axes, mark: Dots) -> None:
    if mark.directions is not None:
        colours: Any = direction_colours(mark.directions) / 255.0
        ax.scatter(mark.xy[:, 0], mark.xy[:, 1], c=colours, s=2, linewidths=0)
        return
    kinds = np.array(mark.colours or (0,) * len(mark.xy), int)
    for place, kind in enumerate(dict.fromkeys(kinds.tolist())):
        chosen = mark.xy[kinds == kind] if place else mark.xy  # draw other colours on top
        ax.plot(*chosen.T, "o", markersize=1.2 * mark.radius, color=_paint(kind))
    for name, at in zip(mark.names if mark.is_labelled else (), mark.xy.tolist(), strict=False):
        ax.annotate(name, at, (4, 4), textcoords="offset points", fontsize=7, parse_math=False)


def _ellipses(ax: Axes, mark: Ellipses) -> None:
    for outline in mark.outlines():
        ax.plot(*outline.T, color=_paint(mark.colour))


def _photo(ax: Axes, mark: Photo) -> None:
    picture: Any = mark.picture
    ax.imshow(picture, extent=(*ax.get_xlim(), *ax.get_ylim()))


def _matrix(ax: Axes, mark: Matrix) -> None:
    image = ax.imshow(mark.values, cmap="RdBu_r", vmin=-1, vmax=1)
    ax.set_xticks(range(len(mark.names)), mark.names, parse_math=False)
    ax.set_yticks(range(len(mark.names)), mark.names, parse_math=False)
    for row, texts in enumerate(mark.texts()):
        for column, text in enumerate(texts):
            ax.text(column, row, text, ha="center", va="center", fontsize=6)
    ax.figure.colorbar(image, ax=ax, label="correlation", shrink=0.8)


_KINDS: dict[type, Callable[..., None]] = {
    Line: _line, Steps: _steps, Places: _places, Bars: _bars, StackedBars: _stacked_bars,
    Cells: _cells, Vectors: _vectors, Dots: _dots, Ellipses: _ellipses, Photo: _photo,
    Matrix: _matrix,
}  # fmt: skip
_WITHOUT_AXES = Bars | StackedBars | Matrix


def _paint(colour: int) -> str:
    return COLOURS[colour % len(COLOURS)]


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
    """Put the legend below the axis, its label and ``below`` points; return its height [points]."""
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

    ``below`` is the height of note and legend in points. With ``named_rows``, the ticks of y are
    names of rows, which need a line each. A figure with several axes keeps its height.
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
    spec = ax.get_subplotspec()
    columns = 1 if spec is None else spec.get_gridspec().ncols
    return float(ax.get_figure(root=True).get_figwidth()) / columns  # type: ignore[union-attr]


def _wrapped(name: str, width: int = 22) -> str:
    return textwrap.fill(name, width, break_long_words=False, break_on_hyphens=False)
