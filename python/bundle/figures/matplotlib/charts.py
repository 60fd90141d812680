"""Predicted and measured cost of solves: functions that draw on a Matplotlib axis."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from bundle.base.arrays import check_type
from bundle.figures.cost_figures import (
    bar_figure,
    breakdown_figure,
    column_figure,
    profile_figure,
    time_figure,
)
from bundle.figures.matplotlib.draw import draw
from bundle.planning.comparison.comparison_result import Comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_flops(ax: Axes, flops: Mapping[str, float], *, impossible: Collection[str] = ()) -> None:
    """Draw the predicted flops of a step as bars on a log scale.

    Args:
        ax: axis to draw on.
        flops: flops of each method by name; NaN and 0 have no bar.
        impossible: names of methods that do not fit in memory; their bars are hatched.
    """
    check_type("flops", flops, Mapping)
    figure = bar_figure("flops", "predicted flops", flops, "{:.2g}".format, impossible)
    draw(ax, figure)
    ax.set_xlabel("flops of one step")


def draw_column_counts(ax: Axes, counts: Mapping[str, ArrayLike]) -> None:
    """Draw nonzeros below the diagonal of L by column, for each method.

    Profiles may have any number of bins; each profile extends over the full width of L.
    """
    check_type("counts", counts, Mapping)
    draw(ax, column_figure({name: np.asarray(given, float) for name, given in counts.items()}))


def draw_cost_against_time(ax: Axes, comparison: Comparison, problem: int = 0) -> None:
    """Draw the distance of each run's cost to the best cost against time, both logarithmic."""
    check_type("comparison", comparison, Comparison)
    draw(ax, time_figure(comparison, problem), comparison.problems[problem].name)


def draw_breakdown(ax: Axes, comparison: Comparison, problem: int = 0) -> None:
    """Draw the phases of each run as stacked bars, the fastest on top."""
    check_type("comparison", comparison, Comparison)
    draw(ax, breakdown_figure(comparison, problem), comparison.problems[problem].name)
    ax.set_xlabel("seconds")


def draw_performance_profile(ax: Axes, comparison: Comparison, gap: float = 1e-3) -> None:
    """Draw the share of problems that each method solves within a factor of the fastest.

    A problem is solved when the cost is within ``gap`` of the best. Without profiles for the gap,
    nothing is drawn; profiles require several problems.
    """
    check_type("comparison", comparison, Comparison)
    draw(ax, profile_figure(comparison, gap), f"performance profile, to {gap:g}")
