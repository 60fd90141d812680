"""Result of a comparison: problems, runs, profiles, recommendation."""

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
from bundle.planning.comparison.profiles import PerformanceProfile

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
"""Relative distances to the best cost at which methods are compared by time."""

Trace = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, kw_only=True)
class ComparedProblem:
    """One input; ``name`` is the path of its file, or "problem 1" for a problem in memory."""

    name: str
    is_file: bool
    format: str
    num_cameras: int
    num_images: int
    num_points: int
    num_observations: int


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """Predicted cost of a method. NaN: not predicted. 0: not applicable.

    Matrices count both triangles and the diagonal; L counts its lower triangle with the diagonal.

    Attributes:
        ordering: order of the factorisation, such as "amd"; "" without a factorisation.
        num_unknowns: columns of S, or of the full system if S is not formed.
        nnz_reduced: nonzeros of the reduced camera system S, even if the solver stores it as dense.
        nnz_factor: nnz(L).
        flops: flops of the factorisation of a step.
        memory_in_bytes: peak memory beyond the loaded problem.
        time_per_step_in_seconds: time of a trust region step.
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
        summary: the solver's summary.
        iterations: one array per field of Ceres' IterationSummary, one entry per iteration.
        build_time_in_seconds: time to build the solver's problem and to copy the result back.
        solve_time_in_seconds: time inside the solver.
        peak_memory_in_bytes: peak resident memory, including interpreter and problem.
        added_memory_in_bytes: peak memory of the solve beyond the loaded problem; -1 if the system
            does not report it.
    """

    summary: Summary
    iterations: dict[str, NDArray[Any]]
    build_time_in_seconds: float
    solve_time_in_seconds: float
    peak_memory_in_bytes: int
    added_memory_in_bytes: int

    @property
    def total_time_in_seconds(self) -> float:
        """Sum of build and solve time, which is all time that depends on the method."""
        return self.build_time_in_seconds + self.solve_time_in_seconds

    @property
    def num_steps(self) -> int:
        """Number of attempted steps, accepted or not, without the start."""
        return len(self.iterations["iteration"]) - 1

    @property
    def time_per_step_in_seconds(self) -> float:
        """Minimizer time per linear solve; NaN without a linear solve."""
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
        """Seconds of residuals, Jacobians and linear solver, and the rest of the total.

        The fused backend eliminates the points while it computes Jacobians; see ``Summary``.
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
        """(Seconds since the loaded problem was passed to the solver, cost) of accepted states."""
        return _trace(self.iterations, self.build_time_in_seconds)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Run(Displayed):
    """All repeats of one method on one problem.

    Attributes:
        problem: index into ``Comparison.problems``.
        outcome: "done" (usable solution, converged or not), "failed" (no usable solution),
            "refused" (the method does not support these options), "timed_out", "out_of_memory",
            "died" or "not_run".
        message: reason in one sentence, unless the outcome is "done".
        measurements: one per completed repeat, in order; empty unless "done" or "failed".
        unfinished: iterations that an incomplete run sent, by the names of Ceres' IterationSummary.
        prediction: predicted cost; None without a prediction.
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
        """True if the run has a usable solution."""
        return self.outcome == "done"

    @property
    def measurement(self) -> Measurement | None:
        """Repeat with the median total time, the faster of the middle two for an even number."""
        if not self.measurements:
            return None
        totals = [one.total_time_in_seconds for one in self.measurements]
        return self.measurements[totals.index(statistics.median_low(totals))]

    @property
    def final_cost(self) -> float:
        """Final cost; NaN without a usable solution."""
        measurement = self.measurement
        return measurement.summary.final_cost if measurement and self.is_usable else math.nan

    @property
    def total_time_in_seconds(self) -> float:
        """Median total time; NaN without a usable solution."""
        measurement = self.measurement
        return measurement.total_time_in_seconds if measurement and self.is_usable else math.nan

    @property
    def peak_memory_in_bytes(self) -> int:
        """Largest peak of all repeats; 0 without a completed repeat."""
        return max((one.peak_memory_in_bytes for one in self.measurements), default=0)

    @property
    def trace(self) -> Trace:
        """(Seconds, costs) of accepted states, also of an incomplete run."""
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
        """Return the seconds to the first state of at most this cost; NaN if it is never reached.

        Times are not interpolated between iterations: a cost counts from the time of its
        evaluation.
        """
        times, costs = self.trace
        reached = np.flatnonzero(costs <= cost)
        return float(times[reached[0]]) if reached.size else math.nan


@dataclass(frozen=True, kw_only=True)
class Recommendation:
    """Recommended method and the reason.

    Attributes:
        reason: one or two sentences that begin with the method's name.
        command: `bundle refine` command line of the method.
        foreseen: for each problem the method that was predicted to be the fastest; None without a
            prediction.
        verdict: comparison of prediction and measurement in one sentence; "" without a prediction.
    """

    method: Method
    reason: str
    command: str
    foreseen: tuple[Method | None, ...] = ()
    verdict: str = ""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Comparison(Displayed):
    """Solves of the same start by several methods.

    Attributes:
        problems: the solved problems.
        runs: one per problem and method, problem by problem, methods in the requested order.
        profiles: one per gap of ``GAPS`` and method; empty with one problem.
        recommendation: None if no run has a usable solution.
        options: options of every solve, except those that the methods vary.
        repeat: requested runs of each method; long runs are not repeated.
        timeout: seconds after which a solve was stopped.
        memory_cap_in_bytes: bytes that a solve could allocate beyond the loaded problem.
        interrupted: True if Ctrl-C ended the comparison.
        wall_time_in_seconds: total wall time.
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
        """All methods in the requested order."""
        return tuple(dict.fromkeys(run.method for run in self.runs))

    def runs_of(self, problem: int) -> tuple[Run, ...]:
        """Return the runs on one problem."""
        return tuple(run for run in self.runs if run.problem == problem)

    def best_cost(self, problem: int) -> float:
        """Return the lowest final cost of a problem; NaN if no run has a usable solution."""
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
            facts.append(("recommended", "none: no method has a usable solution"))
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
    """Return times and costs of accepted states; rejected steps have no state."""
    accepted = np.asarray(iterations["step_is_successful"], bool).copy()
    accepted[:1] = True  # the evaluation at the start
    times = np.asarray(iterations["cumulative_time_in_seconds"], float)[accepted]
    return start + times, np.asarray(iterations["cost"], float)[accepted]
