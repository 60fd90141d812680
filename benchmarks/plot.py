"""Cost gap against time, log-log, one panel a BAL problem."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.rows import GAPS, Run

COLOURS = {"bundle": "#c1272d", "pycolmap": "#0f6fb4", "gtsam": "#3a923a", "scipy": "#7f7f7f"}
LINES = {"auto": "-", "dense-schur": "--", "sparse-schur": "-.", "iterative-schur": ":"}
# Costs printed with seven digits say nothing below this.
SMALLEST_GAP = 1e-7


def _curve(run: Run, best_cost: float) -> tuple[list[float], list[float]]:
    """Return times and the smallest gap so far; rejected steps leave it where it is."""
    times, gaps, lowest = [], [], float("inf")
    for seconds, cost in run["outcome"]["trace"]:
        lowest = min(lowest, cost)
        times.append(seconds)
        gaps.append(max(lowest / best_cost - 1.0, SMALLEST_GAP))
    return times, gaps


def _median_runs(runs: Sequence[Run]) -> dict[str, Run]:
    """Return for each solver the run whose time is the median of its repeats."""
    by_solver: dict[str, list[Run]] = {}
    for run in runs:
        if run["outcome"] is not None:
            by_solver.setdefault(run["solver"], []).append(run)
    return {
        solver: sorted(mine, key=lambda run: run["outcome"]["solve"])[len(mine) // 2]
        for solver, mine in by_solver.items()
    }


def draw(panels: Sequence[tuple[str, Sequence[Run], float]], paths: Sequence[Path]) -> None:
    """Draw (problem, runs, best known cost) panels side by side and save them to every path."""
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "bundle"
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        1, len(panels), figsize=(1 + 4.6 * len(panels), 4.6), squeeze=False, layout="constrained"
    )
    handles: dict[str, Any] = {}
    for axis, (problem, runs, best_cost) in zip(axes[0], panels, strict=True):
        for solver, run in _median_runs(runs).items():
            family, kind = solver.split(" ", 1)
            style = {"color": COLOURS[family], "linestyle": LINES.get(kind, "-")}
            times, gaps = _curve(run, best_cost)
            (line,) = axis.step(times, gaps, where="post", linewidth=1.6, **style)
            handles[solver] = line
        for gap in GAPS:
            axis.axhline(gap, color="0.8", linewidth=0.8, zorder=0)
        axis.set(xscale="log", yscale="log", title=problem, xlabel="seconds after loading")
    axes[0][0].set_ylabel("(cost - best known cost) / best known cost")
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=9)
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=110)
    plt.close(figure)
