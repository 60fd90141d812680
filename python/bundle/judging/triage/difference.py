"""Facts of two solves, and which of them changed beyond noise.

A cost is noise if threads or instruction sets may change it: sums in another order end a solve
elsewhere within its tolerances. Steps of a solve without progress vary more. Times vary most: with
the load of the machine, its clock, and in short solves with the scheduler, which gives the cores to
others for some milliseconds. A time is therefore compared with the time that the steps and flops
explain, without the time in which others held the cores, and the more tolerantly the shorter it is
and the larger the load was.
"""

from __future__ import annotations

import math
import statistics
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import cached_property
from typing import Any

from bundle.base.records import dataclass
from bundle.interface.judging_options import TriageOptions

# Facts of a solve that a triage compares, from the JSON of any report.
#
# All commands state the same facts under the names of :class:`bundle.Summary`. A window of odometry
# solves once per keyframe: its facts are sums and medians over the keyframes.

SECONDS_PER_PREEMPTION = 0.005
"""A time slice, for which a thread waits after an involuntary context switch."""


@dataclass(frozen=True, kw_only=True)
class SolveFacts:
    """Facts of a solve. None if unknown or not applicable."""

    method: str = ""  # name of the method in a comparison; "" elsewhere
    options: Entry = field(default_factory=dict)  # options by name, enumerations in upper case
    columns: float | None = None  # number of free coordinates
    measurements: float | None = None  # number of residuals
    information_nonzeros: float | None = None  # nnz(Lambda), both triangles
    reduced_nonzeros: float | None = None  # nonzeros of the factorised matrix
    factor_nonzeros: float | None = None  # nnz(L)
    factor_flops: float | None = None  # flops of a factorisation
    ordering: str = ""  # elimination order of the factor
    solver: str = ""  # backend and linear solver that were used
    least_flops: float | None = None  # flops in the best order that was tried
    prior_columns: float | None = None  # coordinates that a window's prior couples
    densest: float | None = None  # largest d for which d variables have d - 1 neighbours or more
    initial_cost: float | None = None  # None for odometry
    final_cost: float | None = None  # per residual for odometry
    start_gradient: float | None = None  # largest entry of the gradient at the start
    steps: float | None = None  # attempted steps
    rejected: float | None = None  # rejected steps
    least_radius: float | None = None  # smallest trust region radius of an attempted step
    is_converged: bool = True  # True if a tolerance ended the solve
    is_usable: bool = True  # True with a usable solution
    seconds: float | None = None  # time in the solver
    waiting: float = 0.0  # seconds in which other processes held the cores, at most
    num_threads: int | None = None  # threads of the solver
    warnings: Entry = field(default_factory=dict)  # number of warnings or alarms by kind
    error: float | None = None  # position error against a ground truth


def solve_facts(
    options: Entry,
    summary: Entry,
    iterations: Sequence[Entry],
    structure: Entry,
    method: str = "",
    seconds: float | None = None,
    environment: Entry | None = None,
) -> SolveFacts:
    """Return the facts of a solve from the parts of its report.

    `options` are all options and those of the method, `seconds` the time in the solver if it
    differs from that of the summary.
    """
    rejected = max(
        sum(not step["step_is_successful"] for step in iterations[1:]),
        summary["num_unsuccessful_steps"],
    )
    # Ceres counts the evaluation at the start as a successful step
    steps = max(len(iterations), summary["num_successful_steps"] + rejected) - 1
    # the radius of an entry is the one after its step, which the next step uses
    radii = [_known(step.get("trust_region_radius")) for step in iterations[:-1]]

    def number(name: str) -> float | None:
        return _known(summary.get(name))

    return SolveFacts(
        method=method,
        options=options,
        columns=number("num_parameters_reduced"),
        measurements=number("num_residuals_reduced"),
        information_nonzeros=number("num_information_nonzeros"),
        reduced_nonzeros=number("num_reduced_nonzeros"),
        factor_nonzeros=number("num_factor_nonzeros"),
        factor_flops=number("factor_flops"),
        ordering=str(summary.get("factor_ordering") or ""),
        solver=f"{summary['backend_used']} {summary['linear_solver_type_used']}",
        least_flops=number("least_factor_flops"),
        densest=_known(structure.get("densest")),
        initial_cost=number("initial_cost"),
        final_cost=number("final_cost"),
        start_gradient=_known(iterations[0].get("gradient_max_norm")) if iterations else None,
        steps=float(max(steps, 0)),
        rejected=float(rejected),
        least_radius=min((radius for radius in radii if radius is not None), default=None),
        is_converged=summary["termination_type"] == "CONVERGENCE",
        is_usable=bool(summary["is_solution_usable"]),
        seconds=number("total_time_in_seconds") if seconds is None else seconds,
        waiting=_waiting(environment or {}),
        num_threads=summary["num_threads_used"],
        warnings=Counter(summary["warning_kinds"]),
    )


def flight_facts(report: Entry) -> SolveFacts:
    """Return the facts of odometry: sums and medians over its keyframes."""
    records, error = report["keyframes"], report["error"]

    def median(name: str) -> float | None:
        values = [record[name] for record in records if record.get(name) is not None]
        return _known(statistics.median(values)) if values else None

    rows = sum(record["num_rows"] for record in records)
    cost = sum(cost for record in records for cost in record["costs"].values())
    alarms = Counter(alarm.partition(":")[0] for record in records for alarm in record["alarms"])
    alarms["nullity"] = sum(
        record["nullity"] is not None and record["nullity"] < record["expected_nullity"]
        for record in records
    )
    alarms["out of time"] = sum(record["out_of_time"] for record in records)
    alarms["rejected tracks"] = sum(record["num_rejected_tracks"] for record in records)
    return SolveFacts(
        options=report["options"],
        columns=median("num_columns"),
        measurements=median("num_rows"),
        information_nonzeros=median("num_information_nonzeros"),
        prior_columns=median("num_prior_columns"),
        reduced_nonzeros=median("num_reduced_nonzeros"),
        factor_nonzeros=median("num_factor_nonzeros"),
        final_cost=_known(cost / rows) if rows else None,
        steps=_known(sum(record["num_iterations"] for record in records)),
        rejected=_known(sum(record["num_rejected"] for record in records)),
        least_radius=min(
            (r for record in records if (r := record.get("least_radius")) is not None), default=None
        ),
        is_usable=report["summary"]["is_solution_usable"],
        seconds=report["wall_time"]["solve"],
        waiting=_waiting(report.get("environment") or {}),
        warnings={kind: count for kind, count in alarms.items() if count},
        error=None if error is None else error["ate"],
    )


def _waiting(environment: Entry) -> float:
    preemptions = _known(environment.get("preemptions")) or 0.0
    return max(_known(environment.get("waiting")) or 0.0, SECONDS_PER_PREEMPTION * preemptions)


def _known(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


Entry = Mapping[str, Any]

WITHOUT_EFFECT = ("nullity", "covariance", "check_solution")
"""Options that change a report, but not the solve."""

THREADS = "num_threads"
LEAST_STEPS = 2.0
FLOPS_NOISE, FACTOR_NOISE, NONZEROS_NOISE = 1.1, 1.05, 1.01
PERMUTED_FLOPS_NOISE, PERMUTED_FACTOR_NOISE = 1.6, 1.3
"""Noise of the same matrix with its variables in another order, by which orderings break ties."""
SECONDS_NOISE = 0.02
OTHER_HOST_NOISE, MOST_THREADS_NOISE = 3.0, 2.0
FLIGHT_COST_NOISE = 10.0  # times the noise of other costs
LATE_COST_NOISE = 10.0  # of solves that ended at their time budget, again
ERROR_NOISE = 0.1
SAME_COST = 1e-6
SAME_GRADIENT = 1e-3
LESS_RADIUS, MORE_REJECTED = 0.2, 0.15


@dataclass(frozen=True)
class Difference:
    """Two solves of one input by one method."""

    old: SolveFacts  # facts of both solves
    new: SolveFacts
    inputs: tuple[Entry, Entry]  # path, format, counts and digests of both inputs
    environments: tuple[Entry, Entry]  # machine, load and versions of both; empty if unknown
    limits: TriageOptions  # largest differences that are noise

    def pair(self, name: str) -> tuple[Any, Any]:
        """Return a fact of both solves."""
        return getattr(self.old, name), getattr(self.new, name)

    def ratio(self, name: str) -> float | None:
        """Return the new value divided by the old one; None if one is unknown or 0."""
        old, new = self.pair(name)
        return quotient(new, old)

    def is_same(self, name: str) -> bool:
        """Return True if both solves have the same known value."""
        old, new = self.pair(name)
        return old is not None and old == new

    @cached_property
    def options(self) -> dict[str, tuple[Any, Any]]:
        """Options that differ, without threads and those of the report; None: not listed there."""
        old, new = self.old.options, self.new.options
        names = [name for name in {**old, **new} if name not in (*WITHOUT_EFFECT, THREADS)]
        pairs = {name: (old.get(name), new.get(name)) for name in names}
        return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}

    @cached_property
    def counts(self) -> dict[str, tuple[Any, Any]]:
        """Counts of the input that differ, by name."""
        old, new = self.inputs
        names = [name for name in new if name.startswith("num_") or name == "duration"]
        return {name: (old.get(name), new[name]) for name in names if old.get(name) != new[name]}

    def differs(self, *parts: str) -> bool | None:
        """Return True if a digest of these parts of the input differs; None if it is unknown."""
        digests = [given.get("digests") or {} for given in self.inputs]
        if not all(part in one for part in parts for one in digests):
            return None
        return any(digests[0][part] != digests[1][part] for part in parts)

    @cached_property
    def has_other_data(self) -> bool:
        """True if the measurements or their structure differ."""
        differs = self.differs("structure", "measurements")
        if differs is not None and self.differs("start") is not None:
            is_same_start = not self.differs("start")
            # the same residuals at the same start cost the same
            return differs or (is_same_start and not self.options and not self.is_same_start_cost)
        return bool(self.counts) or not (self.options or self.is_same_start_cost)

    @cached_property
    def is_same_start_cost(self) -> bool:
        """True if the costs at the start agree, or are unknown."""
        old, new = self.pair("initial_cost")
        return old is None or new is None or abs(new - old) <= SAME_COST * max(abs(old), abs(new))

    @cached_property
    def cost_changed(self) -> bool:
        """True if the final cost, or the error against a ground truth, changed beyond noise."""
        if self.old.is_usable != self.new.is_usable:
            return True
        noise = self.limits.cost_noise
        old, new = self.pair("final_cost")
        if self.old.initial_cost is None:  # odometry
            noise *= FLIGHT_COST_NOISE
            if any(solve.warnings.get("out of time") for solve in (self.old, self.new)):
                noise *= LATE_COST_NOISE
        if (old is None) != (new is None):
            return True
        # a cost that is 0 up to rounding has no relative noise
        floor = 1e-12 * (self.old.initial_cost or 0.0)
        if old is not None and new is not None and abs(new - old) > noise * abs(old) + floor:
            return True
        old, new = self.pair("error")
        return bool(old is not None and new is not None and abs(new - old) > ERROR_NOISE * old)

    @cached_property
    def steps_changed(self) -> bool:
        """True if the number of steps changed beyond noise."""
        old, new = self.pair("steps")
        if old is None or new is None:
            return False
        return bool(abs(new - old) > max(LEAST_STEPS, self.limits.step_noise * min(old, new)))

    @cached_property
    def converges_otherwise(self) -> bool:
        """True if one solve converged and the other did not."""
        return self.old.is_converged != self.new.is_converged

    @cached_property
    def factor_changed(self) -> bool:
        """True if flops or nonzeros of the factor changed beyond noise."""
        is_permuted = self.differs("structure") and self.is_same("columns")
        if is_permuted and not self.information_changed:
            flops, nonzeros = PERMUTED_FLOPS_NOISE, PERMUTED_FACTOR_NOISE
        else:
            flops, nonzeros = FLOPS_NOISE, FACTOR_NOISE
        return self._moved("factor_flops", flops) or self._moved("factor_nonzeros", nonzeros)

    @cached_property
    def information_changed(self) -> bool:
        """True if nnz(Lambda) changed beyond noise."""
        return self._moved("information_nonzeros", NONZEROS_NOISE)

    def _moved(self, name: str, noise: float) -> bool:
        ratio = self.ratio(name)
        return ratio is not None and not 1 / noise <= ratio <= noise

    @cached_property
    def has_other_gradient(self) -> bool:
        """True if the gradient J^T r at the start differs; with the same residuals r, J does."""
        old, new = self.pair("start_gradient")
        if old is None or new is None:
            return False
        return bool(abs(new - old) > SAME_GRADIENT * max(abs(old), abs(new)))

    @cached_property
    def radius_fell(self) -> bool:
        """True if the trust region shrank more, or rejected a larger share of the steps."""
        old, new = self.pair("least_radius")
        if old is not None and new is not None and new < LESS_RADIUS * old:
            return True
        shares = [(s.rejected or 0.0) / s.steps if s.steps else 0.0 for s in (self.old, self.new)]
        return shares[1] - shares[0] > MORE_REJECTED

    @cached_property
    def time_excess(self) -> float | None:
        """Ratio of the times beyond what steps and flops explain; None within noise."""
        old, new = self.pair("seconds")
        if not old or not new or old < 0 or new < 0:
            return None
        steps = self.ratio("steps") or 1.0
        work = steps * (self.ratio("factor_flops") or 1.0)
        least, most = min(1.0, steps, work), max(1.0, steps, work)
        noise = self.limits.time_noise + SECONDS_NOISE / min(old, new)
        noise *= self._machine_noise()
        threads = self.pair("num_threads")
        slowed = [_slowed(*given) for given in zip(self.environments, threads, strict=True)]
        ratio = quotient(new, old)
        if new - self.new.waiting > old * most * noise * slowed[1]:
            return quotient(ratio, most)
        is_less = new * noise * slowed[0] < (old - self.old.waiting) * least
        return quotient(ratio, least) if is_less else None

    def _machine_noise(self) -> float:
        noise = 1.0
        if self.has_other_host:
            noise = max(noise, OTHER_HOST_NOISE / self.limits.time_noise)
        threads = self.ratio("num_threads") or 1.0
        return noise * min(max(threads, 1 / threads), MOST_THREADS_NOISE)

    @cached_property
    def has_other_host(self) -> bool:
        """True if another processor ran the second solve."""
        models = [given.get("cpu_model") for given in self.environments]
        return None not in models and models[0] != models[1]

    def new_warnings(self, kinds: tuple[str, ...]) -> list[str]:
        """Return the kinds of these warnings that only the new solve has."""
        return [
            kind
            for kind in kinds
            if self.new.warnings.get(kind) and not self.old.warnings.get(kind)
        ]


def quotient(new: float | None, old: float | None) -> float | None:
    """Return new divided by old, a finite number; None if one is unknown or 0."""
    if not old or not new:
        return None
    return max(-sys.float_info.max, min(new / old, sys.float_info.max))


def _slowed(environment: Entry, num_threads: float | None) -> float:
    """Return the factor by which others on the same cores may have slowed a solve."""
    load, cores = environment.get("load_before"), environment.get("num_cores")
    return max((load + (num_threads or 1)) / cores, 1.0) if load and cores else 1.0


def is_busy(environment: Entry, num_threads: int | None) -> bool:
    """Return True if other processes left too few cores for the threads of a solve."""
    load, cores = environment.get("load_before"), environment.get("num_cores")
    if load is None or cores is None:
        return False
    return bool(load + (num_threads or 1) > cores + 0.5)
