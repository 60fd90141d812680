"""Runs of the benchmark: solvers, problems, stopping rules, numbers of threads."""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import ceres_example, measure, problems, solvers
from benchmarks.problems import BenchmarkProblem
from benchmarks.rows import Run
from benchmarks.solvers import Solver

# Ceres' names; the tolerances are bundle's defaults, which are Ceres' own.
STOPPING = {
    "max_num_iterations": 100,
    "function_tolerance": 1e-6,
    "gradient_tolerance": 1e-10,
    "parameter_tolerance": 1e-8,
}
# For costs that the rule above stops short of.
TIGHT_STOPPING = {
    "max_num_iterations": 300,
    "function_tolerance": 1e-12,
    "gradient_tolerance": 1e-12,
    "parameter_tolerance": 1e-14,
}
RULES = {"default": STOPPING, "tight": TIGHT_STOPPING}

# Runs of a process that took longer, in seconds, are not repeated.
REPEAT_BELOW = 10.0
# With the tight rule, and with one thread, only problems up to here: pycolmap needs minutes beyond.
MOST_OBSERVATIONS_FURTHER = 300_000
# Address space of a child beyond this share of the machine's memory is refused to it.
MEMORY_SHARE = 0.85


@dataclass(frozen=True)
class Series:
    """Runs that are repeats of each other."""

    problem: BenchmarkProblem
    solver: Solver
    rule: str
    threads: int

    def describe(self) -> str:
        """Return the line that progress shows."""
        rule = "" if self.rule == "default" else f", {self.rule}"
        return f"{self.problem.name}: {self.solver.name}, {self.threads} threads{rule}"


def of_problem(
    problem: BenchmarkProblem, wanted: Sequence[Solver], threads: int, quick: bool
) -> list[Series]:
    """Return the series of a problem; without the tight and the one-threaded ones if quick."""
    if problem.is_for_pair:
        wanted = [solver for solver in wanted if solver.name in solvers.PAIR]
    series = [Series(problem, solver, "default", threads) for solver in wanted]
    if quick or problem.is_for_pair:
        return series
    if problem.num_observations <= MOST_OBSERVATIONS_FURTHER:
        tight = [solver for solver in wanted if solver.name in solvers.TIGHT]
        series += [Series(problem, solver, "tight", threads) for solver in tight]
        if threads > 1 and problem.kind == "bal":
            scaled = [solver for solver in wanted if solver.name in solvers.SCALED]
            series += [Series(problem, solver, "default", 1) for solver in scaled]
    return series


def run(series: Series, timeout: float) -> Run:
    """Run a solver once, in its own process."""
    problem, solver = series.problem, series.solver
    answer: Run = {
        "problem": problem.name,
        "solver": solver.name,
        "rule": series.rule,
        "threads": series.threads,
        "wall": 0.0,
        "cpu": 0.0,
        "outcome": None,
    }
    reason = solver.reason_against(problem) or _missing(solver)
    if reason:
        return {**answer, "failure": reason}
    child, outcome = _run_process(series, timeout)
    failure = child.failure or outcome.get("failure", "")
    return {
        **answer,
        "failure": failure,
        "wall": child.wall,
        "cpu": child.cpu,
        "outcome": None if failure else outcome,
    }


def _missing(solver: Solver) -> str:
    """Return what is to be said of a peer that is not there."""
    if solver.runner == "ceres_example":
        return ceres_example.reason_missing()
    package = solver.runner.rstrip("_")
    return "not installed" if importlib.util.find_spec(package) is None else ""


def _run_process(series: Series, timeout: float) -> tuple[measure.Child, dict[str, Any]]:
    with tempfile.TemporaryDirectory() as folder:
        request, answer = Path(folder) / "request.json", Path(folder) / "answer.json"
        fields = {
            "path": str(series.problem.path),
            "kind": series.problem.kind,
            "solver": series.solver.solver,
            "backend": series.solver.backend,
            "threads": series.threads,
            "memory_limit": int(MEMORY_SHARE * measure.physical_memory()),
            **RULES[series.rule],
        }
        request.write_text(json.dumps(fields))
        module = f"benchmarks.runners.{series.solver.runner}"
        command = [sys.executable, "-m", module, str(request), str(answer)]
        env = measure.environment(problems.ROOT, series.threads)
        child = measure.run_child(command, env, timeout)
        return child, {} if child.failure else json.loads(answer.read_text())


def run_interleaved(all_series: Sequence[Series], options: argparse.Namespace) -> list[Run]:
    """Run every series ``options.repeat`` times, one of each a round.

    What failed, and what took longer than REPEAT_BELOW, is not repeated.
    """
    runs: list[Run] = []
    left = list(all_series)
    for repeat in range(options.repeat):
        for series in list(left):
            done = run(series, options.timeout)
            runs.append(done)
            said = done["failure"] or f"{done['wall']:.1f} s"
            print(f"{series.describe()}, run {repeat + 1}: {said}", file=sys.stderr)
            if done["failure"] or done["wall"] > REPEAT_BELOW:
                left.remove(series)
    return runs
