"""Figures of compared solves of a graph: cost against time, and time by phase."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bundle.figures.cost_figures import cost_against_time
from bundle.figures.drawing import Figure
from bundle.figures.marks import StackedBars, Steps
from bundle.figures.series import gaps_to
from bundle.planning.comparison.graph_comparison import GraphComparison, GraphRun, best_cost

MOST_DRAWN = 8
"""Number of the fastest methods in a figure."""

PHASES = {
    "set-up": "preprocessor_time_in_seconds",
    "Jacobians": "jacobian_evaluation_time_in_seconds",
    "residuals": "residual_evaluation_time_in_seconds",
    "linear solver": "linear_solver_time_in_seconds",
}


def graph_time_figure(found: GraphComparison) -> Figure:
    """Return the distance of each run's cost to the best cost against time, both logarithmic."""
    best = best_cost(found.runs)
    marks = []
    backends = list(dict.fromkeys(_backend(run) for run in found.runs))
    for colour, run in enumerate(_fastest(found)):
        table = run.result.iterations
        times, costs = table["cumulative_time_in_seconds"], table["cost"]
        known = np.isfinite(costs) & (times > 0)
        if known.any() and np.isfinite(best):
            gaps = gaps_to(best, costs[known])
            line = backends.index(_backend(run))
            marks.append(Steps(_name(found, run), times[known], gaps, colour, line))
    return cost_against_time(marks, "the start")


def graph_breakdown_figure(found: GraphComparison) -> Figure:
    """Return the phases of each run as stacked bars, the fastest on top."""
    rows = {}
    for run in _fastest(found):
        summary = run.result.summary
        parts = {name: float(getattr(summary, field) or 0.0) for name, field in PHASES.items()}
        rest = float(summary.total_time_in_seconds or 0.0) - sum(parts.values())
        rows[_name(found, run)] = parts | {"rest": max(0.0, rest)}
    return Figure(name="breakdown", title="Where the time went", marks=(StackedBars(rows, " s"),))


def _fastest(found: GraphComparison) -> Sequence[GraphRun]:
    usable = [run for run in found.runs if not run.failure and run.result is not None]
    return sorted(usable, key=lambda run: run.time_in_seconds)[:MOST_DRAWN]


def _backend(run: GraphRun) -> str:
    return str(getattr(run.method, "backend", ""))


def _name(found: GraphComparison, run: GraphRun) -> str:
    several = len({one.method.num_threads for one in found.runs}) > 1
    return f"{run.method.name}, {run.method.num_threads}" if several else str(run.method.name)
