"""What a comparison gives back: problems, runs, profiles, one recommendation."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.memory_sizes import format_size
from bundle.base.words import change, contents, number, plural, seconds
from bundle.errors import shown
from bundle.interface.options import SolveOptions
from bundle.interface.summary import Summary
from bundle.planning.comparison.method import Method

__all__ = [
    "GAPS",
    "ComparedProblem",
    "Comparison",
    "Measurement",
    "PerformanceProfile",
    "Prediction",
    "Recommendation",
    "Run",
]

GAPS = (1e-2, 1e-3, 1e-5)
"""Relative distances to the best cost, the times to which are compared."""

Trace = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, kw_only=True)
class ComparedProblem:
    """One input: ``name`` is the path of its file, or "problem 1" for one from memory."""

    name: str
    is_file: bool
    format: str
    num_cameras: int
    num_images: int
    num_points: int
    num_observations: int


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """What was known before the solve; NaN where nothing is predicted, 0 where there is none.

    Matrices count both triangles and the diagonal; L counts its lower triangle with the diagonal.

    Attributes:
        ordering: what orders the factorisation, such as "amd"; "" where nothing is factorised.
        num_unknowns: columns of S, or of the whole system where no S is made.
        nnz_reduced: nonzeros of the reduced camera system S, whether the solver stores its zeros or
            not.
        nnz_factor: nonzeros of L.
        flops: of one factorisation, of which each step makes one.
        memory_in_bytes: peak beyond the loaded problem.
        time_per_step_in_seconds: of one trust region step.
    """

    ordering: str
    num_unknowns: int
    nnz_reduced: float
    nnz_factor: float
    flops: float
    memory_in_bytes: float
    time_per_step_in_seconds: float
    fits_in_memory: bool
    note: str = ""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Measurement(Displayed):
    """One solve in one process.

    Attributes:
        summary: what the solver says.
        iterations: one array a field of Ceres' IterationSummary, one entry an iteration.
        build_time_in_seconds: from the arrays to the solver's problem and back.
        solve_time_in_seconds: inside the solver.
        peak_memory_in_bytes: the most that was resident, interpreter and problem included.
        added_memory_in_bytes: the peak of the solve beyond the loaded problem; -1 where the system
            does not tell.
    """

    summary: Summary
    iterations: dict[str, NDArray[Any]]
    build_time_in_seconds: float
    solve_time_in_seconds: float
    peak_memory_in_bytes: int
    added_memory_in_bytes: int

    @property
    def total_time_in_seconds(self) -> float:
        """Return build and solve: all that depends on the method."""
        return self.build_time_in_seconds + self.solve_time_in_seconds

    @property
    def num_steps(self) -> int:
        """Return the number of steps tried, accepted or not; the start is none."""
        return len(self.iterations["iteration"]) - 1

    @property
    def time_per_step_in_seconds(self) -> float:
        """Return the minimizer's time by linear system solved; NaN if none was."""
        solves = self.summary.num_linear_solves
        return self.summary.minimizer_time_in_seconds / solves if solves > 0 else math.nan

    def _display(self) -> Display:
        summary = self.summary
        facts = (
            ("cost", change(summary.initial_cost, summary.final_cost)),
            ("steps", str(self.num_steps)),
            ("time", f"{seconds(self.total_time_in_seconds)} s"),
            ("peak memory", format_size(self.peak_memory_in_bytes)),
        )
        return Display(title=f"Measurement: {summary.termination_type}", facts=facts)

    @property
    def breakdown(self) -> dict[str, float]:
        """Return the seconds of residuals, Jacobians, linear solver and the rest of the total.

        The fused backend eliminates the points while it computes Jacobians, see ``Summary``.
        """
        summary = self.summary
        parts = {
            "residuals": max(summary.residual_evaluation_time_in_seconds, 0.0),
            "Jacobians": max(summary.jacobian_evaluation_time_in_seconds, 0.0),
            "linear solver": max(summary.linear_solver_time_in_seconds, 0.0),
        }
        return {**parts, "rest": max(self.total_time_in_seconds - sum(parts.values()), 0.0)}

    @property
    def trace(self) -> Trace:
        """Return (seconds since the loaded problem was handed over, cost) of accepted states."""
        return _trace(self.iterations, self.build_time_in_seconds)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Run(Displayed):
    """One method on one problem, all repeats.

    Attributes:
        problem: index into ``Comparison.problems``.
        outcome: "done" (with a usable solution, converged or not), "failed" (the solver found
            none), "refused" (the method cannot serve these options), "timed_out",
            "out_of_memory", "died" or "not_run".
        message: why, in one sentence, unless the outcome is "done".
        measurements: one per repeat that ended, in order; empty unless "done" or "failed".
        unfinished: iterations that a run had sent before its process ended early, under the names
            of Ceres' IterationSummary.
        prediction: None where nothing was predicted.
    """

    problem: int
    method: Method
    outcome: str
    message: str = ""
    measurements: tuple[Measurement, ...] = ()
    unfinished: dict[str, NDArray[Any]] | None = None
    prediction: Prediction | None = None

    @property
    def is_usable(self) -> bool:
        """Whether there is a solution to compare."""
        return self.outcome == "done"

    @property
    def measurement(self) -> Measurement | None:
        """Return the repeat of median total time; the faster of the two in the middle."""
        if not self.measurements:
            return None
        totals = [one.total_time_in_seconds for one in self.measurements]
        return self.measurements[totals.index(statistics.median_low(totals))]

    @property
    def final_cost(self) -> float:
        """Return the cost at the end; NaN without a usable solution."""
        measurement = self.measurement
        return measurement.summary.final_cost if measurement and self.is_usable else math.nan

    @property
    def total_time_in_seconds(self) -> float:
        """Return the median total time; NaN without a usable solution."""
        measurement = self.measurement
        return measurement.total_time_in_seconds if measurement and self.is_usable else math.nan

    @property
    def peak_memory_in_bytes(self) -> int:
        """Return the largest peak of all repeats; 0 where none ended."""
        return max((one.peak_memory_in_bytes for one in self.measurements), default=0)

    @property
    def trace(self) -> Trace:
        """Return (seconds, costs) of accepted states, of a run that did not end too."""
        if self.measurement is not None:
            return self.measurement.trace
        return _trace(self.unfinished, 0.0) if self.unfinished else (np.empty(0), np.empty(0))

    def _display(self) -> Display:
        title = f"Run: {self.method.name}, {self.method.threads}: {self.outcome}"
        if self.measurement is None or not self.is_usable:
            return Display(title=title, facts=(("message", self.message),))
        facts = (
            ("cost", number(self.final_cost)),
            ("time", f"{seconds(self.total_time_in_seconds)} s"),
            ("repeats", str(len(self.measurements))),
        )
        return Display(title=title, facts=facts)

    def time_to(self, cost: float) -> float:
        """Return the seconds to the first state of at most this cost; NaN if there is none.

        Times between iterations are not interpolated: a cost is reached when it has been computed.
        """
        times, costs = self.trace
        reached = np.flatnonzero(costs <= cost)
        return float(times[reached[0]]) if reached.size else math.nan


@dataclass(frozen=True, kw_only=True)
class PerformanceProfile:
    """Share of problems that a method solves within a factor of the fastest (Dolan and More 2002).

    A problem is solved when the cost is within ``gap`` of the best, the measure is the time to it.

    Attributes:
        ratios: to the fastest method on each problem that this one solved, ascending.
        num_problems: all that somebody solved.
    """

    method: Method
    gap: float
    ratios: tuple[float, ...]
    num_problems: int

    def share(self, factor: float) -> float:
        """Return the share of problems solved within this factor of the fastest, 0 to 1."""
        return sum(ratio <= factor for ratio in self.ratios) / max(self.num_problems, 1)


@dataclass(frozen=True, kw_only=True)
class Recommendation:
    """What to take and why.

    Attributes:
        reason: one or two sentences that begin with the method's name.
        command: a ready command line of `bundle refine`.
        foreseen: the method that would have been recommended before anything was measured, one for
            each problem; None where there was nothing to tell it from.
        verdict: whether that was right, in one sentence; "" where nothing was foreseen.
    """

    method: Method
    reason: str
    command: str
    foreseen: tuple[Method | None, ...] = ()
    verdict: str = ""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Comparison(Displayed):
    """The same start under several methods.

    Attributes:
        problems: what was solved.
        runs: one for each problem and method, problem by problem, methods in the order asked for.
        profiles: one for each gap of ``GAPS`` and method; empty with one problem.
        recommendation: None where no run has a usable solution.
        options: of every solve, but for what the methods vary.
        repeat: how often each run was to be made; one that took long is not repeated.
        timeout: seconds after which a solve was stopped.
        memory_cap_in_bytes: that a solve could take beyond the loaded problem.
        interrupted: whether Ctrl-C ended the comparison.
        wall_time_in_seconds: of everything.
    """

    problems: tuple[ComparedProblem, ...]
    runs: tuple[Run, ...]
    profiles: tuple[PerformanceProfile, ...]
    recommendation: Recommendation | None
    options: SolveOptions
    repeat: int
    timeout: float
    memory_cap_in_bytes: int
    interrupted: bool
    wall_time_in_seconds: float

    @property
    def methods(self) -> tuple[Method, ...]:
        """Return every method, in the order asked for."""
        return tuple(dict.fromkeys(run.method for run in self.runs))

    def runs_of(self, problem: int) -> tuple[Run, ...]:
        """Return the runs on one problem."""
        return tuple(run for run in self.runs if run.problem == problem)

    def best_cost(self, problem: int) -> float:
        """Return the lowest final cost of a problem; NaN where no run has a usable solution."""
        costs = [run.final_cost for run in self.runs_of(problem) if run.is_usable]
        return min(costs, default=math.nan)

    def gap(self, run: Run) -> float:
        """Return a run's final cost / the best one - 1; NaN without a usable solution."""
        best = self.best_cost(run.problem)
        return run.final_cost / best - 1 if best > 0 else run.final_cost - best

    def time_to_gap(self, run: Run, gap: float) -> float:
        """Return the seconds to (1 + gap) times the best cost; NaN if it was not reached."""
        return run.time_to((1 + gap) * self.best_cost(run.problem))

    def _display(self) -> Display:
        facts = [(shown(problem.name), contents(problem)) for problem in self.problems]
        found = self.recommendation
        if found is None:
            facts.append(("recommended", "nothing: no method has a usable solution"))
        else:
            facts += [("recommended", found.reason), ("command", found.command)]
        return Display(
            title=f"Comparison of {plural(len(self.methods), 'method')}"
            f"{', interrupted' if self.interrupted else ''}",
            facts=tuple(facts),
            head=("method", "threads", "problem", "outcome", "gap", "time [s]", "peak memory"),
            rows=tuple(self._row(run) for run in self.runs),
        )

    def _row(self, run: Run) -> tuple[str, ...]:
        gap = self.gap(run)
        return (
            run.method.name,
            str(run.method.num_threads),
            str(run.problem + 1),
            run.outcome.replace("_", " "),
            f"{gap:.0e}" if math.isfinite(gap) else "-",
            seconds(run.total_time_in_seconds),
            format_size(run.peak_memory_in_bytes),
        )


def _trace(iterations: dict[str, NDArray[Any]], start: float) -> Trace:
    """Return when which cost was reached; a rejected step's cost is that of no state."""
    accepted = np.asarray(iterations["step_is_successful"], bool).copy()
    accepted[:1] = True  # the evaluation at the start
    times = np.asarray(iterations["cumulative_time_in_seconds"], float)[accepted]
    return start + times, np.asarray(iterations["cost"], float)[accepted]
