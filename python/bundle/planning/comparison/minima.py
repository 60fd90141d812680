"""Minima at which the methods of a comparison ended.

Solutions within one sigma of that of the lowest cost are at the same minimum: no measurement could
tell them apart. Single points at other positions do not count. A solution farther away is at
another minimum, or its method stopped too early. To distinguish these cases, one method continues
from each solution at tight tolerances. Solutions whose continuations meet are at one minimum. Costs
alone cannot distinguish them: an early stop and a poor minimum can have the same gap.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.comparison.measured_run import Run
from bundle.planning.comparison.method import Method
from bundle.planning.comparison.process import WorkerEnd
from bundle.planning.comparison.solution_distance import SolutionDistance

SAME = 1.0
"""Distance in sigmas up to which two solutions are at the same minimum."""

Refine = Callable[[Run, Path], WorkerEnd]


def find_minima(
    problem: Problem,
    options: SolveOptions,
    runs: Sequence[Run],
    solutions: Mapping[Method, Path],
    refine: Refine | None,
) -> list[Run]:
    """Return the runs with their distances and minima.

    Args:
        problem: the problem of all runs.
        options: options of the solves.
        runs: one run per method.
        solutions: stored solutions; runs without one keep an unknown minimum.
        refine: continues the solution of a run at tight tolerances and stores the result at a path;
            None to leave distant solutions at an unknown minimum.
    """
    usable = [run for run in runs if run.is_usable and solutions[run.method].exists()]
    if not usable:
        return list(runs)
    best = min(usable, key=lambda run: run.final_cost)
    distance = SolutionDistance(problem, options, solutions[best.method], _redundancy(best))
    apart = {
        run.method: distance.between(solutions[run.method], solutions[best.method])
        for run in usable
    }
    far = [run for run in usable if apart[run.method].sigmas > SAME]
    numbers = {run.method: 0 for run in usable if run not in far}
    if far and refine is not None:
        found = _minima([best, *far], solutions, distance, refine)
        if best.method in found:
            numbers = dict.fromkeys(numbers, found[best.method]) | found
    return [
        dataclasses.replace(
            run,
            distance_in_sigmas=apart[run.method].sigmas,
            num_points_elsewhere=apart[run.method].num_points,
            minimum=numbers.get(run.method, -1),
        )
        if run.method in apart
        else run
        for run in runs
    ]


def _redundancy(run: Run) -> int:
    """Return the number of residuals minus the number of parameters."""
    assert run.measurement is not None  # the caller chose a usable run
    summary = run.measurement.summary
    return summary.num_residuals_reduced - summary.num_parameters_reduced


def _minima(
    runs: Sequence[Run],
    solutions: Mapping[Method, Path],
    distance: SolutionDistance,
    refine: Refine,
) -> dict[Method, int]:
    """Continue the runs; return the number of the minimum of each that converged."""
    ends: list[tuple[float, Method, Path]] = []
    for run in runs:
        target = solutions[run.method].with_suffix(".end.npz")
        summary = (refine(run, target).measurement or {}).get("summary", {})
        if summary.get("termination_type") == "CONVERGENCE" and target.exists():
            ends.append((summary["final_cost"], run.method, target))
    centres: list[Path] = []
    numbers: dict[Method, int] = {}
    for _, method, path in sorted(ends, key=lambda end: end[0]):
        near = (
            k for k, centre in enumerate(centres) if distance.between(path, centre).sigmas <= SAME
        )
        number = next(near, len(centres))
        if number == len(centres):
            centres.append(path)
        numbers[method] = number
    return numbers
