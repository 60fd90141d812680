"""Facts of a solve that a triage compares, from the JSON of any report.

All commands state the same facts under the names of :class:`bundle.Summary`. A window of odometry
solves once per keyframe: its facts are sums and medians over the keyframes.
"""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Any

from bundle.base.records import dataclass

Entry = Mapping[str, Any]

SECONDS_PER_PREEMPTION = 0.005
"""A time slice, for which a thread waits after an involuntary context switch."""


@dataclass(frozen=True, kw_only=True)
class SolveFacts:
    """Facts of a solve. None: unknown or not applicable.

    Attributes:
        method: name of the method in a comparison; "" elsewhere.
        options: options by name, enumerations in upper case.
        columns: number of free coordinates.
        measurements: number of residuals.
        information_nonzeros: nnz(Lambda), both triangles.
        reduced_nonzeros: nonzeros of the factorised matrix.
        factor_nonzeros: nnz(L).
        factor_flops: flops of a factorisation.
        ordering: elimination order of the factor.
        solver: backend and linear solver that were used.
        least_flops: flops in the best order that was tried.
        prior_columns: coordinates that a window's prior couples.
        densest: largest d for which d variables have d - 1 neighbours or more.
        initial_cost, final_cost: costs; of odometry the second only, per residual.
        start_gradient: largest entry of the gradient at the start.
        steps: attempted steps.
        rejected: rejected steps.
        least_radius: smallest trust region radius of an attempted step.
        is_converged: True if a tolerance ended the solve.
        is_usable: True with a usable solution.
        seconds: time in the solver.
        waiting: seconds in which other processes held the cores, at most.
        num_threads: threads of the solver.
        warnings: number of warnings or alarms by kind.
        error: position error against a ground truth.
    """

    method: str = ""
    options: Entry = field(default_factory=dict)
    columns: float | None = None
    measurements: float | None = None
    information_nonzeros: float | None = None
    reduced_nonzeros: float | None = None
    factor_nonzeros: float | None = None
    factor_flops: float | None = None
    ordering: str = ""
    solver: str = ""
    least_flops: float | None = None
    prior_columns: float | None = None
    densest: float | None = None
    initial_cost: float | None = None
    final_cost: float | None = None
    start_gradient: float | None = None
    steps: float | None = None
    rejected: float | None = None
    least_radius: float | None = None
    is_converged: bool = True
    is_usable: bool = True
    seconds: float | None = None
    waiting: float = 0.0
    num_threads: int | None = None
    warnings: Entry = field(default_factory=dict)
    error: float | None = None


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

    `options` are all options and those of the method, `seconds` the time in the solver if that of
    the summary is another.
    """
    rejected = max(
        sum(not step["step_is_successful"] for step in iterations[1:]),
        summary["num_unsuccessful_steps"],
    )
    # Ceres counts the evaluation at the start as a successful step
    steps = max(len(iterations), summary["num_successful_steps"] + rejected) - 1
    # the radius of an entry is the one after its step, which the next step uses
    radii = [_known(step.get("trust_region_radius")) for step in iterations[:-1]]
    number = _reader(summary)
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


def _reader(entry: Entry) -> Callable[[str], float | None]:
    return lambda name: _known(entry.get(name))


def _waiting(environment: Entry) -> float:
    preemptions = _known(environment.get("preemptions")) or 0.0
    return max(_known(environment.get("waiting")) or 0.0, SECONDS_PER_PREEMPTION * preemptions)


def _known(value: Any) -> float | None:
    """Return a finite number, or None."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None
