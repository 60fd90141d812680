"""What a solve is predicted to cost, and what it did: functions of a Matplotlib axis."""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.arguments import check_type
from bundle.figures.matplotlib.series import cost_curve, labels, profile_curve, styles
from bundle.planning.comparison.comparison_result import Comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "draw_breakdown",
    "draw_column_counts",
    "draw_cost_against_time",
    "draw_flops",
    "draw_performance_profile",
]

# Okabe and Ito's colours, which the colour-blind tell apart too, then three greys of other hues.
COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#5b5b5b", "#8c6bb1",
    "#9a6324", "#469990",
)  # fmt: skip
LINES = ("-", "--", ":", "-.")
# Characters of a title, of labels of which two stand side by side, and of a line of a label on an
# axis narrower than 4 inches, by the inch.
TITLE, OF_TWO, OF_A_LINE = 11.0, 5.5, 7.0
WIDE = 4.0  # inches from which labels have one line
# Points that ticks and label take below an axis.
LABELS_BELOW = 38


def draw_flops(ax: Axes, flops: Mapping[str, float], *, impossible: Collection[str] = ()) -> None:
    """Draw the predicted flops of a step as bars on a log scale.

    Args:
        ax: where.
        flops: of each method, by its name; what is NaN or 0 has no bar.
        impossible: names of methods that do not fit in memory: they are hatched.
    """
    check_type("flops", flops, Mapping)
    values = np.array([*flops.values()], float)
    values[~(values > 0)] = np.nan
    lowest, highest = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
    lowest, highest = (lowest / 10, highest) if np.isfinite(highest) else (1.0, 10.0)
    ax.set_xscale("log")
    lengths = np.fmax(values, lowest) - lowest
    bars = ax.barh(np.arange(len(values)), lengths, left=lowest, color=COLOURS[0])
    for bar, name, value in zip(bars, flops, values, strict=True):
        if name in impossible:
            bar.set(facecolor="none", edgecolor=COLOURS[1], hatch="////")
        text = "none" if np.isnan(value) else f"{value:.2g}"
        text += "\ndoes not fit" if name in impossible else ""
        middle = bar.get_y() + bar.get_height() / 2
        ax.annotate(
            text, (lowest if np.isnan(value) else value, middle), (3, 0),
            textcoords="offset points", va="center", fontsize=8,
        )  # fmt: skip
    ax.set_xlim(lowest, highest * (highest / lowest) ** 0.6)  # room for the words
    ax.set_yticks(np.arange(len(values)), [*map(_wrapped, flops)], fontsize=7)
    ax.set(ylim=(len(values) - 0.4, -0.6), xlabel="flops of one step", title="predicted flops")


def draw_column_counts(ax: Axes, counts: Mapping[str, ArrayLike]) -> None:
    """Draw nonzeros below the diagonal of L, by column, for each method.

    Profiles may have any number of bins; each is drawn over the whole width of L.
    """
    check_type("counts", counts, Mapping)
    for index, (name, profile) in enumerate(counts.items()):
        values = np.asarray(profile, float)
        place = np.linspace(0.0, 1.0, len(values) + 1)
        colour = COLOURS[index % len(COLOURS)]
        ax.stairs(values, place, label=name, color=colour, linewidth=1.4)
    ax.set(
        xlabel="columns of L, as eliminated",
        ylabel="nonzeros below the diagonal",
        title="column counts of L",
        xlim=(0, 1),
        ylim=(0, None),
        xticks=[0, 0.5, 1],
        xticklabels=["first", "middle", "last"],
    )
    if counts:
        legend_below(ax)


def draw_cost_against_time(ax: Axes, comparison: Comparison, problem: int = 0) -> None:
    """Draw the distance of each run's cost to the best against time, both logarithmic."""
    check_type("comparison", comparison, Comparison)
    names, looks = labels(comparison.methods), styles(comparison.methods)
    for index, run in enumerate(comparison.runs):
        times, gaps = cost_curve(comparison, index)
        if run.problem == problem and len(times):
            look = looks[run.method]
            ax.step(
                np.maximum(times, 1e-6), gaps, where="post", label=names[run.method],
                color=COLOURS[look.colour % len(COLOURS)],
                linestyle=LINES[look.line % len(LINES)], linewidth=1.5,
            )  # fmt: skip
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="seconds from the loaded problem on",
        ylabel="cost / best cost - 1",
    )
    _title(ax, comparison.problems[problem].name)
    ax.grid(which="major", color="0.9")
    if ax.lines:
        legend_below(ax)


def draw_breakdown(ax: Axes, comparison: Comparison, problem: int = 0) -> None:
    """Draw where the time of each run went, as stacked bars, the fastest on top."""
    check_type("comparison", comparison, Comparison)
    names = labels(comparison.methods)
    runs = [run for run in comparison.runs_of(problem) if run.is_usable]
    runs.sort(key=lambda run: run.total_time_in_seconds)
    left = np.zeros(len(runs))
    parts = [run.measurement.breakdown for run in runs if run.measurement is not None]
    for index, phase in enumerate(parts[0] if parts else ()):
        seconds = np.array([part[phase] for part in parts])
        colour = COLOURS[index] if phase != "rest" else "0.75"
        ax.barh(np.arange(len(runs)), seconds, left=left, label=phase, color=colour)
        left += seconds
    ax.set_yticks(np.arange(len(runs)), [_wrapped(names[run.method]) for run in runs], fontsize=7)
    ax.set(ylim=(len(runs) - 0.4, -0.6), xlabel="seconds")
    _title(ax, comparison.problems[problem].name)
    if runs:
        legend_below(ax)


def draw_performance_profile(ax: Axes, comparison: Comparison, gap: float = 1e-3) -> None:
    """Draw the share of problems that each method solves within a factor of the fastest.

    A problem is solved when the cost is within ``gap`` of the best. Nothing is drawn where the
    comparison has no profiles for the gap, which takes several problems.
    """
    check_type("comparison", comparison, Comparison)
    names, looks = labels(comparison.methods), styles(comparison.methods)
    profiles = [profile for profile in comparison.profiles if profile.gap == gap]
    largest = max((ratio for one in profiles for ratio in one.ratios), default=1.0)
    for profile in profiles:
        look = looks[profile.method]
        factors, shares = profile_curve(profile, max(1.1 * largest, 2.0))
        ax.step(
            factors, shares, where="post", label=names[profile.method],
            color=COLOURS[look.colour % len(COLOURS)], linestyle=LINES[look.line % len(LINES)],
        )  # fmt: skip
    ax.set(
        xscale="log",
        ylim=(-0.02, 1.02),
        xlabel=f"time to {gap:g} / the fastest's",
        ylabel="share of problems",
        title="performance profile",
    )
    if profiles:
        legend_below(ax)


def legend_below(ax: Axes) -> None:
    """Put the legend where no curve is: under the axis and its label."""
    from matplotlib.transforms import offset_copy

    handles, names = ax.get_legend_handles_labels()
    inches = _inches(ax)
    two_fit = max(map(len, names)) <= OF_TWO * inches
    if inches < WIDE and not two_fit:
        names = [_wrapped(name, round(OF_A_LINE * inches)) for name in names]
    ax.legend(
        handles,
        names,
        fontsize=7,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=offset_copy(
            ax.transAxes, ax.get_figure(root=True), y=-LABELS_BELOW, units="points"
        ),
        borderaxespad=0.0,
        ncols=2 if two_fit else 1,
    )


def _title(ax: Axes, name: str) -> None:
    """Show the name of a problem, of a long one the end, which tells files apart."""
    longest = max(round(TITLE * _inches(ax)), 10)
    shown = name if len(name) <= longest else "..." + name[3 - longest :]
    ax.set_title(shown, fontsize=9, parse_math=False)


def _inches(ax: Axes) -> float:
    """Return the width of an axis with all that is written around it."""
    spec = ax.get_subplotspec()
    columns = 1 if spec is None else spec.get_gridspec().ncols
    return float(ax.get_figure(root=True).get_figwidth()) / columns  # type: ignore[union-attr]


def _wrapped(name: str, width: int = 22) -> str:
    """Return the name of a method in short lines."""
    return textwrap.fill(name, width, break_long_words=False, break_on_hyphens=False)
