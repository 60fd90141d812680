"""Headline and findings of `bundle compare`: verdict, and limits of the measurements."""

from __future__ import annotations

import math
from collections.abc import Iterator

from bundle.base.words import duration, few, plural
from bundle.errors import shown
from bundle.interface.finding import Finding
from bundle.planning.comparison.comparison_result import Comparison
from bundle.planning.comparison.measured_run import Run
from bundle.planning.comparison.recommendation import (
    SAME,
    command_line,
    comparison_command,
    reached_best,
)

SUGGESTED = 1e-3
"""Suggested size of a perturbation: some pixels, from which real models return to their minimum."""


def sigmas(distance: float) -> str:
    """Return a distance in sigmas with two digits; "-" if it is unknown."""
    if not math.isfinite(distance):
        return "-"
    if distance < 0.005:
        return "0" if distance < 1e-9 else "<0.01"
    return f"{distance:.2g}" if distance < 1000 else f"{distance:.0e}"


def headline(comparison: Comparison) -> list[str]:
    """Return the verdict: warning of a start at its minimum, best method, and solutions."""
    sentences: list[str] = []
    single = len(comparison.problems) == 1
    for index, problem in enumerate(comparison.problems):
        if comparison.is_at_minimum(index):
            name = "The input" if single else shown(problem.name)
            start = "; compare from a perturbed start with --perturb"
            if comparison.perturb:
                start = f", even after --perturb {comparison.perturb:g}"
            sentences.append(f"{name} is at its minimum{start}.")
    if comparison.interrupted:
        sentences.append("Interrupted: methods that had not run are missing.")
    found = comparison.recommendation
    usable = [run for run in comparison.runs if run.is_usable]
    if found is None and not usable:
        sentences.append("No method has a usable solution.")
    elif found is not None and (doubts := doubted(comparison)):
        sentences.append(f"No recommendation: {doubts}; {found.method.name} was fastest.")
    elif found is not None:
        sentences.append(_recommended(comparison) if single else f"Recommended: {found.reason}")
    return [*sentences, *_solutions(comparison)]


def doubted(comparison: Comparison) -> str:
    """Return the reason why the fastest method is not recommended; "" if it is."""
    if any(_unfinished(comparison)):
        return "no solve with the lowest cost converged; allow more steps (--max-iterations)"
    return "the machine was busy, so that times are not valid" if any(_busy(comparison)) else ""


def _recommended(comparison: Comparison) -> str:
    found = comparison.recommendation
    assert found is not None  # the caller checked it
    winner = next(run for run in comparison.runs_of(0) if run.method == found.method)
    words = f"Recommended: {found.method.name}, {duration(winner.total_time_in_seconds)}"
    spread = winner.spread
    if spread is not None and spread.num_repeats > 1:
        times = f"{duration(spread.min)} to {duration(spread.max)}"
        words += f" ({times} in {spread.num_repeats} runs)"
    ties = [
        run.method.name
        for run in comparison.runs_of(0)
        if run is not winner and reached_best(comparison, run) and _overlap(run, winner)
    ]
    if ties:
        words += f"; repeats of {few(ties)} overlap with it"
    return f"{words}."


def _overlap(run: Run, winner: Run) -> bool:
    one, other = run.spread, winner.spread
    return bool(one and other and other.num_repeats > 1 and one.min <= other.max)


def _solutions(comparison: Comparison) -> Iterator[str]:
    for index, problem in enumerate(comparison.problems):
        place = "" if len(comparison.problems) == 1 else f" on {shown(problem.name)}"
        minima = comparison.minima(index)
        runs = [run for run in comparison.runs_of(index) if run.is_usable]
        unknown = sum(run.minimum < 0 and math.isfinite(run.distance_in_sigmas) for run in runs)
        if len(minima) > 1:
            yield (
                f"The methods end in {len(minima)} minima{place}: no method is recommended across "
                "them, because their times lead to different solutions."
            )
        elif minima and len(minima[0]) > 1:
            most = sigmas(max(run.distance_in_sigmas for run in minima[0]))
            count = plural(len(minima[0]), "solution")
            points = max(run.num_points_elsewhere for run in minima[0])
            but = f", apart from {plural(points, 'point')}" if points else ""
            yield f"{count}{place} at one minimum, within {most} sigmas of the lowest cost{but}."
        if unknown:
            verb = "is" if unknown == 1 else "are"
            yield (
                f"{plural(unknown, 'solution')}{place} {verb} farther away and did not converge "
                "when continued: minimum unknown."
            )


def findings(comparison: Comparison) -> list[Finding]:
    """Return findings that make the measurements invalid or the recommendation doubtful."""
    found = []
    at_minimum = [k for k in range(len(comparison.problems)) if comparison.is_at_minimum(k)]
    if at_minimum:
        gap = max(comparison.start_gap(index) for index in at_minimum)
        size = 10 * comparison.perturb or SUGGESTED
        found.append(
            Finding(
                kind="at-minimum",
                sentence=f"The cost of the start is {100 * gap:.2g} % above the lowest cost: all "
                "methods stop after few steps, and their times hardly differ.",
                command=comparison_command(comparison, perturb=min(size, 0.1)),
                evidence={"start_gap": gap, "problems": at_minimum},
            )
        )
    return [*found, *_busy(comparison), *_unfinished(comparison), *_early(comparison)]


def _busy(comparison: Comparison) -> Iterator[Finding]:
    here = comparison.environment
    threads = max((method.num_threads for method in comparison.methods), default=1)
    if not here.is_busy(threads):
        return
    ratios = [one.cpu_per_wall for run in comparison.runs for one in run.measurements]
    yield Finding(
        kind="busy-machine",
        sentence=f"The load was {here.load_before:.1f} on {plural(here.num_cores, 'core')} before "
        f"the first run, and solves used {plural(threads, 'thread')}: their times are not valid. "
        "Repeat the comparison when the machine is idle.",
        evidence={
            "load_before": here.load_before,
            "num_cores": here.num_cores,
            "num_threads": threads,
            "least_cpu_per_wall": min(ratios, default=math.nan),
        },
    )


def _unfinished(comparison: Comparison) -> Iterator[Finding]:
    """Yield a finding if the recommended method was stopped by the limit of iterations."""
    best = comparison.recommendation
    runs = [run for run in comparison.runs if best is not None and run.method == best.method]
    steps = [
        run.measurement.num_steps
        for run in runs
        if run.measurement and run.measurement.summary.termination_type == "NO_CONVERGENCE"
    ]
    if best is not None and steps:
        yield Finding(
            kind="not-converged",
            sentence=f"{best.method.name} did not converge in {plural(max(steps), 'step')}: the "
            "lowest cost is not known, and gaps refer to an unfinished solve.",
            evidence={"num_steps": max(steps)},
        )


def _early(comparison: Comparison) -> Iterator[Finding]:
    """Yield a finding if the recommended method stops more than a sigma from the lowest cost."""
    best = comparison.recommendation
    if best is None:
        return
    runs = [run for run in comparison.runs if run.method == best.method]
    apart = max((run.distance_in_sigmas for run in runs), default=math.nan)
    if not apart > SAME:
        return
    tolerance = comparison.options.function_tolerance / 100
    options = best.method.options(comparison.options).replace(function_tolerance=tolerance)
    problem = comparison.problems[0]
    single = len(comparison.problems) == 1 and problem.is_file
    yield Finding(
        kind="early-stop",
        sentence=f"{best.method.name} stops {sigmas(apart)} sigmas from the solution of the lowest "
        "cost: a smaller tolerance gives a better solution.",
        command=command_line(options, problem.name if single else "INPUT"),
        evidence={"distance_in_sigmas": apart},
    )
