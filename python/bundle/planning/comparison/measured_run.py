"""Records of a comparison: methods, their predicted costs, and their measurements."""

from __future__ import annotations

import dataclasses
import itertools
import math
import statistics
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import change, format_size, number, plural, seconds
from bundle.errors import InputError, brief
from bundle.interface.option_fields import number as checked_number
from bundle.interface.options import SolveOptions
from bundle.interface.planning_options import (
    BACKENDS,
    ORDERINGS,
    PRECONDITIONERS,
    SOLVERS,
    THREADS,
    TRUST_REGIONS,
)
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.summary import Summary

Trace = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """Predicted cost of a method. NaN: not predicted. 0: not applicable.

    Matrices count both triangles and the diagonal; L counts its lower triangle with the diagonal.
    """

    ordering: str  # order of the factorisation, such as "amd"; "" without a factorisation
    num_unknowns: int  # columns of S, or of the full system if S is not formed
    # nonzeros of the reduced camera system S, even if the solver stores it as dense
    nnz_reduced: float
    nnz_factor: float  # nnz(L)
    flops: float  # flops of the factorisation of a step
    memory_in_bytes: float  # peak memory beyond the loaded problem
    time_per_step_in_seconds: float  # time of a trust region step
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
    """All repeats of one method on one problem."""

    problem: int  # index into ``Comparison.problems``
    method: Method
    # "done" (usable solution, converged or not), "failed" (no usable solution), "refused" (the
    # method does not support these options), "timed_out", "out_of_memory", "died" or "not_run"
    outcome: str
    message: str = ""  # reason in one sentence, unless the outcome is "done"
    # one per completed repeat, in order; empty unless "done" or "failed"
    measurements: tuple[Measurement, ...] = ()
    # iterations that an incomplete run sent, by the names of Ceres' IterationSummary
    unfinished: dict[str, NDArray[Any]] | None = None
    prediction: Prediction | None = None  # predicted cost; None without a prediction
    # distance of the solution from that of the lowest cost, see ``solution_distance``; NaN if
    # unknown
    distance_in_sigmas: float = math.nan
    # points at other positions than in that solution, which the distance leaves out
    num_points_elsewhere: int = 0
    # number of the minimum at which the run ended, from 0 in the order of costs; -1 if unknown
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


_USUAL = "levenberg_marquardt"
ITERATIVE = ("iterative_schur", "cgnr")


@dataclass(frozen=True, kw_only=True)
class Method:
    """Options that a comparison varies, by the names and values of SolveOptions.

    ``num_threads`` is never 0. ``preconditioner_type`` is "auto" for direct solvers.
    """

    backend: str
    linear_solver_type: str
    linear_solver_ordering: str = "points_first"
    preconditioner_type: str = "auto"
    trust_region_strategy_type: str = _USUAL
    num_threads: int

    @property
    def name(self) -> str:
        """Return "fused SPARSE_SCHUR" with non-default values, without threads."""
        words = [self.backend, self.linear_solver_type.upper()]
        if self.preconditioner_type != "auto":
            words.append(self.preconditioner_type.upper())
        if self.linear_solver_ordering != "points_first":
            words.append(self.linear_solver_ordering.replace("_", " "))
        if self.trust_region_strategy_type != _USUAL:
            words.append(self.trust_region_strategy_type.replace("_", "-"))
        return " ".join(words)

    @property
    def threads(self) -> str:
        """Return text such as "2 threads"."""
        return plural(self.num_threads, "thread")

    @property
    def is_iterative(self) -> bool:
        """True if the linear solver is iterative for every problem."""
        return self.linear_solver_type in ITERATIVE

    def options(self, base: SolveOptions) -> SolveOptions:
        """Return the options of a solve by this method."""
        return base.replace(**dataclasses.asdict(self))


@dataclass(frozen=True, kw_only=True)
class GraphMethod:
    """Options of a compared method, named as in :class:`bundle.PoseGraphOptions`.

    ``ordering`` is "" for Ceres, which chooses its own.
    """

    backend: str
    trust_region_strategy_type: str
    ordering: str
    num_threads: int

    @property
    def name(self) -> str:
        """Return a name such as "fused amd gauss-newton"."""
        words = (self.backend, self.ordering, self.trust_region_strategy_type.replace("_", "-"))
        return " ".join(filter(None, words))

    def options(self, base: PoseGraphOptions) -> PoseGraphOptions:
        """Return the options of a solve by this method."""
        return base.replace(**dataclasses.asdict(self) | {"ordering": self.ordering or "auto"})


@dataclass(frozen=True, kw_only=True)
class FactorGraphMethod:
    """Options of a compared solve of a factor graph, named as in :class:`bundle.SolveOptions`.

    ``linear_solver_type`` is "square_root" for a QR factorisation of the Jacobian.
    """

    linear_solver_type: str
    trust_region_strategy_type: str
    num_threads: int

    @property
    def name(self) -> str:
        """Return a name such as "sparse-normal-cholesky dogleg"."""
        words = (self.linear_solver_type, self.trust_region_strategy_type)
        return " ".join(words).replace("_", "-")

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of :meth:`bundle.FactorGraph.solve`."""
        given = dataclasses.asdict(self)
        if self.linear_solver_type == "square_root":
            del given["linear_solver_type"]
            given = {"square_root": True} | given
        return given


def expand(
    *,
    solvers: Iterable[str] = SOLVERS,
    preconditioners: Iterable[str] = PRECONDITIONERS,
    orderings: Iterable[str] = ORDERINGS,
    backends: Iterable[str] = BACKENDS,
    trust_regions: Iterable[str] = TRUST_REGIONS,
    threads: Iterable[int] = THREADS,
) -> tuple[Method, ...]:
    """Return the methods, backend by backend.

    Values without effect, such as the preconditioner of a direct solver, are dropped, and so are
    doglegs of iterative solvers if Levenberg-Marquardt is compared, too: they need exact steps.
    Thread counts are limited to the number of cores, as in a solve; 0 stands for all cores.
    """
    given: dict[str, tuple[Any, ...]] = {
        "backend": as_tuple("backends", backends),
        "linear_solver_type": as_tuple("solvers", solvers),
        "linear_solver_ordering": as_tuple("orderings", orderings),
        "preconditioner_type": as_tuple("preconditioners", preconditioners),
        "trust_region_strategy_type": as_tuple("trust_regions", trust_regions),
        "num_threads": thread_counts("num_threads", as_tuple("threads", threads)),
    }
    for name, values in given.items():
        if not values:
            raise InputError(f"{name}: expected at least one value to compare, found 0")
    combinations = itertools.product(*given.values())
    chosen = (SolveOptions(**dict(zip(given, values, strict=True))) for values in combinations)
    methods = dict.fromkeys(map(_method, chosen))
    usual = {method for method in methods if method.trust_region_strategy_type == _USUAL}
    return tuple(m for m in methods if m in usual or not (usual and m.is_iterative))


def as_tuple(argument: str, values: Any) -> tuple[Any, ...]:
    """Return the values of a list; a single word becomes a list with one value."""
    if isinstance(values, str):
        return (values,)
    try:
        return tuple(values)
    except TypeError:
        raise InputError(f"{argument}: expected a list, found {brief(values)}") from None


def thread_counts(argument: str, values: Iterable[Any]) -> tuple[int, ...]:
    """Return the distinct effective thread counts: at most the number of cores; 0 becomes all."""
    cores = _core.hardware_threads()
    checked = [checked_number(argument, count, whole=True, minimum=0) for count in values]
    return tuple(dict.fromkeys(min(count or cores, cores) for count in checked))


def _method(options: SolveOptions) -> Method:
    used = options.without_idle()
    return Method(**{field.name: getattr(used, field.name) for field in dataclasses.fields(Method)})
