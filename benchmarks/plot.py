"""Cost gap against time, one panel a BAL problem, and cost against observations; all log-log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import scaling
from benchmarks.results import Results
from benchmarks.rows import GAPS, Run

COLOURS = {
    "bundle fused": "#c1272d",
    "bundle ceres": "#e08a1e",
    "bundle": "#222222",
    "pycolmap": "#0f6fb4",
    "ceres-example": "#7b4fa3",
    "gtsam": "#3a923a",
    "scipy": "#7f7f7f",
}
MARKERS = {"auto": "o", "dense-schur": "s", "sparse-schur": "^", "iterative-schur": "v"}
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


def _style(solver: str) -> dict[str, Any]:
    """Return the colour of a solver's family and the line of its linear solver."""
    colour = next(colour for family, colour in COLOURS.items() if solver.startswith(family))
    return {"color": colour, "linestyle": LINES.get(solver.rpartition(" ")[2], "-")}


def _pyplot() -> Any:
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams["svg.hashsalt"] = "bundle"
    import matplotlib.pyplot as plt

    return plt


def _save(figure: Any, paths: Sequence[Path]) -> None:
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=110)
    _pyplot().close(figure)


def draw(panels: Sequence[tuple[str, Sequence[Run], float]], paths: Sequence[Path]) -> None:
    """Draw (problem, runs, best known cost) panels side by side and save them to every path."""
    figure, axes = _pyplot().subplots(
        1,
        len(panels),
        figsize=(max(1 + 4.6 * len(panels), 10), 5.4),
        squeeze=False,
        layout="constrained",
    )
    handles: dict[str, Any] = {}
    for axis, (problem, runs, best_cost) in zip(axes[0], panels, strict=True):
        for solver, run in _median_runs(runs).items():
            times, gaps = _curve(run, best_cost)
            (line,) = axis.step(times, gaps, where="post", linewidth=1.6, **_style(solver))
            handles[solver] = line
        for gap in GAPS:
            axis.axhline(gap, color="0.8", linewidth=0.8, zorder=0)
        axis.set(xscale="log", yscale="log", title=problem, xlabel="seconds after loading")
    axes[0][0].set_ylabel("(cost - best known cost) / best known cost")
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=9)
    _save(figure, paths)


def draw_totals(rows: Sequence[tuple[str, float, float | None]], paths: Sequence[Path]) -> None:
    """Draw (problem, the peer's total over ours, our Ceres backend's over ours) as bars."""
    figure, axis = _pyplot().subplots(figsize=(6.4, 0.9 + 0.5 * len(rows)), layout="constrained")
    names = [name for name, _, _ in rows]
    series = (
        ("pycolmap", -0.19, COLOURS["pycolmap"], [peer for _, peer, _ in rows]),
        ("Ceres by bundle", 0.19, COLOURS["bundle ceres"], [ceres for _, _, ceres in rows]),
    )
    for label, shift, colour, values in series:
        places = [place + shift for place in range(len(rows))]
        bars = axis.barh(
            places, [value or 0.0 for value in values], 0.36, color=colour, label=label
        )
        texts = [f"{value:.1f}" if value else "" for value in values]
        axis.bar_label(bars, texts, padding=3, fontsize=8)
    axis.axvline(1.0, color=COLOURS["bundle fused"], linewidth=1.6, label="bundle")
    axis.set(yticks=range(len(rows)), yticklabels=names, xlabel="total time, multiples of bundle's")
    axis.invert_yaxis()
    axis.margins(x=0.1)
    axis.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=3, fontsize=9, frameon=False)
    _save(figure, paths)


def draw_scaling(results: Results, solvers: Sequence[str], paths: Sequence[Path]) -> bool:
    """Draw total time against observations, with fitted powers; False if there is no curve."""
    curves = {solver: scaling.points(results, solver) for solver in solvers}
    curves = {solver: found for solver, found in curves.items() if len(found) > 1}
    if not curves:
        return False
    figure, axis = _pyplot().subplots(figsize=(8.4, 5.0), layout="constrained")
    for solver, found in curves.items():
        sizes = [size for size, _ in found]
        totals = [row.total for _, row in found if row.total]
        middle = [total.median for total in totals]
        spread = [
            [total.median - total.low for total in totals],
            [total.high - total.median for total in totals],
        ]
        power = scaling.exponent(results, solver)
        marker = MARKERS.get(solver.rpartition(" ")[2], "o")
        label = f"{solver}: N^{power:.2f}"
        axis.errorbar(sizes, middle, spread, marker=marker, label=label, **_style(solver))
    axis.set(xscale="log", yscale="log", xlabel="observations", ylabel="seconds after loading")
    axis.grid(which="both", color="0.92")
    figure.legend(loc="outside right upper", fontsize=9)
    _save(figure, paths)
    return True
