"""Tables and targets of what is no reconstruction: pose graphs, preintegration, windows.

Each is measured by a module of its own (``benchmarks.pose_graphs``, ``inertial``, ``windows``),
which ``run.py`` runs as a process of its own, and whose runs come as JSON.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks import table
from benchmarks.measure import Spread

OURS, CERES, GTSAM, G2O = "bundle", "Ceres", "GTSAM", "g2o"
MANY = "synthetic"
"""The set of very many poses, made here."""

GraphRuns = Mapping[str, Mapping[str, Sequence[Mapping[str, float]]]]
"""By data set and solver: seconds, linear systems solved, chi2."""
InertialRuns = Mapping[str, Mapping[str, Sequence[float]]]
"""By implementation and samples of an interval: microseconds per sample."""


def graph_seconds(found: GraphRuns, name: str, solver: str) -> Spread | None:
    """Return the spread of the times of a solver on a set."""
    return Spread.of(run["seconds"] for run in found.get(name, {}).get(solver, ()))


def graphs_table(found: GraphRuns) -> str:
    """Return one line a set and solver; "" without any."""
    lines = []
    for name, runs in found.items():
        ours = graph_seconds(found, name, OURS)
        for solver, mine in runs.items():
            took = graph_seconds(found, name, solver)
            if took is None:
                lines.append([name, solver, "no result", "", "", ""])
                continue
            ratio = table.ratio(took, ours) if ours is not None else ""
            last = mine[-1]
            end = [str(int(last["solves"])), f"{last['chi2']:.9g}"]
            lines.append([name, solver, table.absolute(took), ratio, *end])
    header = ["set", "solver", "time", "ratio", "linear systems", "chi2"]
    return table.grid(header, lines) if lines else ""


def inertial_table(found: InertialRuns) -> str:
    """Return one line an implementation; "" without any."""
    lines = [
        [name, *(f"{statistics.median(times):.3f}" for times in by_interval.values())]
        for name, by_interval in found.items()
    ]
    if not lines:
        return ""
    intervals = next(iter(found.values()))
    return table.grid(["us per sample", *(f"{interval} samples" for interval in intervals)], lines)


def window_seconds(found: Mapping[str, Any], who: str) -> Spread | None:
    """Return the spread of the processor times."""
    return Spread.of(run["seconds"] for run in found.get("runs", {}).get(who, ()))


def windows_table(found: Mapping[str, Any]) -> str:
    """Return one line for each of both; "" where nothing was measured."""
    if not found:
        return ""
    ours = window_seconds(found, OURS)
    size = " ".join(f"{found[what]} {what}" for what in ("keyframes", "landmarks", "observations"))
    lines = []
    for who, runs in found["runs"].items():
        took = window_seconds(found, who)
        if took is None:
            lines.append([who, "no result", "", "", ""])
            continue
        end = [f"{runs[-1]['cost']:.4f}", str(runs[-1]["steps"])]
        lines.append([who, table.absolute(took), table.ratio(took, ours), *end])
    return table.grid([size, "CPU time", "ratio", "cost", "steps"], lines)
