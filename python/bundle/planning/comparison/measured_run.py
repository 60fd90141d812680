"""Measurements of a comparison: one solve, all repeats of a method, and the predicted cost."""

from __future__ import annotations

import math
import statistics
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import change, format_size, number, seconds
from bundle.interface.summary import Summary
from bundle.planning.comparison.method import Method

Trace = tuple[NDArray[np.float64], NDArray[np.float64]]


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
        cpu_per_wall: CPU time of all threads / wall time of the solve; NaN if unknown. Less than 1
            means that other processes held the cores.
        load: load average of the last minute when the solve began; NaN if unknown.
    """

    summary: Summary
    iterations: dict[str, NDArray[Any]]
    build_time_in_seconds: float
    solve_time_in_seconds: float
    peak_memory_in_bytes: int
    added_memory_in_bytes: int
    cpu_per_wall: float = math.nan
    load: float = math.nan

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


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Spread of the total times of all repeats of a run, in seconds."""

    num_repeats: int
    min: float
    median: float
    max: float

    @property
    def relative(self) -> float:
        """(max - min) / median; NaN with fewer than two repeats."""
        return (self.max - self.min) / self.median if self.num_repeats > 1 else math.nan


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
        distance_in_sigmas: distance of the solution from that of the lowest cost, see
            ``solution_distance``; NaN if unknown.
        num_points_elsewhere: points at other positions than in that solution, which the distance
            leaves out.
        minimum: number of the minimum at which the run ended, from 0 in the order of costs; -1 if
            unknown.
    """

    problem: int
    method: Method
    outcome: str
    message: str = ""
    measurements: tuple[Measurement, ...] = ()
    unfinished: dict[str, NDArray[Any]] | None = None
    prediction: Prediction | None = None
    distance_in_sigmas: float = math.nan
    num_points_elsewhere: int = 0
    minimum: int = -1

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
    def spread(self) -> Spread | None:
        """Spread of the total times; None without a usable solution."""
        totals = [one.total_time_in_seconds for one in self.measurements]
        if not totals or not self.is_usable:
            return None
        return Spread(
            num_repeats=len(totals),
            min=min(totals),
            median=self.total_time_in_seconds,
            max=max(totals),
        )

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


def _trace(iterations: dict[str, NDArray[Any]], start: float) -> Trace:
    """Return times and costs of accepted states; rejected steps have no state."""
    accepted = np.asarray(iterations["step_is_successful"], bool).copy()
    accepted[:1] = True  # the evaluation at the start
    times = np.asarray(iterations["cumulative_time_in_seconds"], float)[accepted]
    return start + times, np.asarray(iterations["cost"], float)[accepted]
