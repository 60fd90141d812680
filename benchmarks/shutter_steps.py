"""Processor time of a step with rolling shutters, over that with global shutters.

Prints a row per filmed scene and a column per kind of twists: fused, one thread, intrinsics held.
The time of a step is that of STEPS further steps of a solve, divided by STEPS, without set-up and
input. The kinds take turns; the table has medians of ratios.

Run: python -m benchmarks.shutter_steps [--repeat N] [--json FILE]
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping, Sequence
from typing import Any

import bundle
from benchmarks import measure, table

SCENES: dict[str, dict[str, Any]] = {
    "phone": {"scene": "orbit", "num_images": 30, "num_points": 900, "rolling_shutter": 0.8},
    "car": {"scene": "street", "num_images": 300, "num_points": 6000, "rolling_shutter": 0.6},
    "drone": {"scene": "drone_grid", "num_images": 300, "num_points": 9000, "rolling_shutter": 0.6},
}
KINDS: dict[str, dict[str, Any]] = {
    "global": {},
    "free": {},
    "tied": {"twists": "tied", "twist_sigma": (0.004, 0.004)},
    "hard": {"twists": "hard"},
}
STEPS = 4

Runs = Mapping[str, Mapping[str, Sequence[float]]]


def problem_of(scene: Mapping[str, Any], kind: str) -> bundle.Problem:
    """Return a scene at its start, with global shutters or rolling ones."""
    problem = bundle.synthesize(seed=4, **scene).problem
    return problem.replace(rolling_shutter=None) if kind == "global" else problem


def step_time(problem: bundle.Problem, kind: str) -> float:
    """Return seconds of processor time of one step."""
    took = []
    for steps in (1, 1 + STEPS):
        options = {
            **{f"{name}_tolerance": 1e-300 for name in ("function", "gradient", "parameter")},
            **{"backend": "fused", "num_threads": 1, "refine": ("poses", "points")},
            **{"max_num_iterations": steps, "check_solution": False, **KINDS[kind]},
        }
        start = time.process_time()
        bundle.solve(problem, **options)
        took.append(time.process_time() - start)
    return (took[1] - took[0]) / STEPS


def measured(repeat: int) -> dict[str, dict[str, list[float]]]:
    """Return seconds per step, by scene and kind of twists, of runs."""
    took: dict[str, dict[str, list[float]]] = {}
    for name, scene in SCENES.items():
        problems = {kind: problem_of(scene, kind) for kind in KINDS}
        took[name] = {kind: [] for kind in KINDS}
        for _ in range(repeat):
            for kind, problem in problems.items():
                took[name][kind].append(step_time(problem, kind))
    return took


def steps_table(found: Runs) -> str:
    """Return a line per scene: milliseconds of a global step, and ratios to it."""
    lines = []
    for name, runs in found.items():
        first, *others = runs.values()
        ratios = [
            statistics.median(b / a for a, b in zip(first, other, strict=True)) for other in others
        ]
        lines.append(
            [
                name,
                f"{1e3 * statistics.median(first):.2f}",
                *(f"{ratio:.2f}" for ratio in ratios),
            ]
        )
    return table.grid(["scene", "global [ms]", *list(KINDS)[1:]], lines)


if __name__ == "__main__":
    measure.run_alone(__doc__, measured, steps_table)
