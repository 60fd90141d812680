"""Slide a window over a chain of positions; marginalise or drop the oldest, or keep all.

The positions x_0 .. x_60 lie on a line. There are a prior on the first (information 1), odometry
between neighbours (4), and between every second (9). A window holds six positions. Before it moves,
the oldest position is

- marginalised: its factors become a prior on the other variables that they touch. The problem is
  linear, so the estimate of the window equals the batch estimate, to rounding;
- dropped: its factors are lost, and with them the absolute position. The oldest remaining position
  is fixed at its last estimate instead, and the window drifts by tenths of a metre.

With a path it draws the result: ``python sliding_window.py window.png`` (needs Matplotlib).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import bundle

STEPS, WINDOW = 60, 6
INFORMATION = {0: 1.0, 1: 4.0, 2: 9.0}  # prior, odometry, skip


def measurements(seed: int) -> dict[tuple[int, int], float]:
    """Return the measurements between positions i and j: 1 m per step, and noise."""
    rng = np.random.default_rng(seed)
    return {
        (i, i + gap): gap + rng.normal() / INFORMATION[gap] ** 0.5
        for i in range(STEPS + 1)
        for gap in (1, 2)
        if i + gap <= STEPS
    }


def add_position(graph: bundle.FactorGraph, k: int, measured: dict) -> None:
    """Add position k and the measurements between it and its predecessors in the graph."""
    graph.add_variable(k, [float(k)])
    for gap in (1, 2):
        if k - gap in graph.keys:
            value = measured[k - gap, k]
            graph.add_factor(bundle.BetweenFactor(k - gap, k, [value], INFORMATION[gap]))


def start() -> bundle.FactorGraph:
    """Return the graph of the first position."""
    graph = bundle.FactorGraph()
    graph.add_variable(0, [0.0])
    graph.add_factor(bundle.PriorFactor(0, [0.0], INFORMATION[0]))
    return graph


def optimum(graph: bundle.FactorGraph) -> bundle.FactorGraph:
    """Return a linear graph at its optimum: one Gauss-Newton step."""
    matrix, vector = graph.information()
    step = np.linalg.solve(matrix, vector)
    return graph.with_values(
        {key: graph.values[key] + d for key, d in zip(graph.keys, step, strict=True)}
    )


def slide(measured: dict, how: str) -> tuple[np.ndarray, bundle.FactorGraph]:
    """Return the newest position's estimate after each step, and the last window."""
    window, newest = start(), []
    for k in range(1, STEPS + 1):
        add_position(window, k, measured)
        window = optimum(window)
        newest.append(window.values[k][0])
        if how != "keep" and len(window.keys) == WINDOW:
            oldest, *rest = window.keys
            values = window.values
            window = window.forget([oldest], how)
            if how == "drop":  # without a prior on its place the chain could be anywhere
                window.add_factor(bundle.PriorFactor(rest[0], values[rest[0]], 1e6))
    return np.array(newest), window


def run(seed: int = 0) -> dict[str, np.ndarray]:
    """Return the differences of the newest positions from the batch estimate, in metres."""
    measured = measurements(seed)
    everything, _ = slide(measured, "keep")
    return {how: np.abs(slide(measured, how)[0] - everything) for how in ("marginalize", "drop")}


def draw(differences: dict[str, np.ndarray], path: Path) -> None:
    """Draw the differences by step; zeros are drawn at 1e-17."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    axis = figure.subplots()
    words = {"marginalize": "oldest marginalised", "drop": "oldest dropped"}
    for (how, difference), marker in zip(differences.items(), ("o", "s"), strict=True):
        steps = np.arange(1, len(difference) + 1)
        axis.semilogy(steps, np.maximum(difference, 1e-17), marker, ms=4, label=words[how])
    axis.set(
        xlabel="step",
        ylabel="newest position against keeping everything [m]",
        title=f"A window of {WINDOW} positions: marginalising loses nothing",
    )
    axis.grid(visible=True, alpha=0.3)
    axis.legend(loc="center right")
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    result = run()
    for how, difference in result.items():
        print(f"{how:12} max {difference.max():.1e} m, median {np.median(difference):.1e} m")
    _, window = slide(measurements(0), "marginalize")
    (prior,) = (f for f in window.factors if isinstance(f, bundle.LinearPrior))
    print(prior)
    if len(sys.argv) > 1:
        draw(result, Path(sys.argv[1]))
