"""Adjustment in segments: several solves of a few iterations, each from the end of the last.

The state of a solver contains more than the values of its problem: the trust region radius, the
chart of each rotation, and the scaling of the columns. A solve that restarts from saved values
therefore takes different steps. For this reason a run that can be resumed always solves in
segments: after every ``interval`` iterations the solver restarts from the values and the radius,
which the checkpoint holds. A killed and resumed run then does the same solves from the same values
as an uninterrupted run.

Up to the tolerances, both runs end at the same minimum as a single solve, after about as many
steps: a restart costs the set-up. With cheirality "zero" every segment, like every round,
determines again which observations are behind their camera. A round starts at the initial radius
of its options, because the filter changed the cost.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from bundle.interface.options import SolveOptions
from bundle.interface.solve_record import Progress
from bundle.interface.summary import Summary
from bundle.interface.trust_region_fields import LARGEST_RADIUS
from bundle.model.problem import Problem
from bundle.solving.result import Result

OF_A_SEGMENT = ("max_num_iterations", "initial_trust_region_radius")
"""Options that differ from segment to segment."""
COUNTS = ("num_residual_evaluations", "num_jacobian_evaluations", "num_linear_solves")


def solve_in_segments(
    solve: Callable[[Problem, SolveOptions, Progress | None], Result],
    problem: Problem,
    options: SolveOptions,
    interval: int,
    *,
    so_far: Result | None = None,
    progress: Progress | None = None,
    save: Callable[[Result], None],
) -> Result:
    """Adjust a problem in segments.

    Args:
        so_far: result of the previous segments; None without any.
        progress: function called after each iteration; iteration numbers continue across segments.
    """
    while True:
        done = 0 if so_far is None else num_steps(so_far)
        length = min(interval, options.max_num_iterations - done)
        changes: dict[str, Any] = {"max_num_iterations": length}
        if so_far is not None:
            changes["initial_trust_region_radius"] = _last_radius(so_far)
        segment = solve(
            problem,
            options.replace(**changes),
            progress if so_far is None else _counting_on(progress, so_far),
        )
        problem = segment.problem
        so_far = segment if so_far is None else join(so_far, segment)
        goes_on = (
            segment.summary.termination_type == "NO_CONVERGENCE"
            and segment.summary.is_solution_usable
            and not segment.summary.interrupted
            and 0 < num_steps(segment) == length
            and num_steps(so_far) < options.max_num_iterations
        )
        if not goes_on:
            given = {name: getattr(options, name) for name in OF_A_SEGMENT}
            return dataclasses.replace(so_far, options=so_far.options.replace(**given))
        save(so_far)


def _last_radius(result: Result) -> float:
    """Return the radius with which the solver would have continued."""
    return min(float(result.iterations["trust_region_radius"][-1]), LARGEST_RADIUS)


def num_steps(result: Result) -> int:
    """Return the number of steps, including rejected steps."""
    return len(result.iterations["iteration"]) - 1


def join(first: Result, second: Result) -> Result:
    """Join the results of two segments into the result of one adjustment."""
    a, b = first.iterations, second.iterations
    iterations = {name: np.concatenate([a[name], b[name][1:]]) for name in a}
    tail = slice(len(a["iteration"]), None)
    for name in ("iteration", "cumulative_time_in_seconds"):
        iterations[name][tail] += a[name][-1]
    return dataclasses.replace(
        second,
        initial_problem=first.initial_problem,
        iterations=iterations,
        summary=_join_summaries(first.summary, second.summary),
        factor_costs_before=first.factor_costs_before,
        build_time_in_seconds=first.build_time_in_seconds + second.build_time_in_seconds,
        solve_time_in_seconds=first.solve_time_in_seconds + second.solve_time_in_seconds,
    )


def _join_summaries(first: Summary, second: Summary) -> Summary:
    changes: dict[str, Any] = {"initial_cost": first.initial_cost}
    times = [field.name for field in dataclasses.fields(Summary) if "_time_in_sec" in field.name]
    for name in (*COUNTS, *times):
        one, other = getattr(first, name), getattr(second, name)
        if one is not None and other is not None and one >= 0 and other >= 0:  # -1: not measured
            changes[name] = one + other
    # Each segment counts the evaluation at its start as a successful step.
    changes["num_successful_steps"] = first.num_successful_steps + second.num_successful_steps - 1
    changes["num_unsuccessful_steps"] = first.num_unsuccessful_steps + second.num_unsuccessful_steps
    steps = changes["num_successful_steps"] + changes["num_unsuccessful_steps"] - 1
    changes["message"] = re.sub(r"(Number of iterations: )\d+", rf"\g<1>{steps}", second.message)
    return dataclasses.replace(second, **changes)


def _counting_on(progress: Progress | None, so_far: Result) -> Progress | None:
    if progress is None:
        return None
    last = {name: values[-1] for name, values in so_far.iterations.items()}

    def later(values: dict[str, Any]) -> None:
        if values["iteration"] == 0:
            return  # already reported as the last iteration of the previous segment
        counted = {
            name: values[name] + last[name] for name in ("iteration", "cumulative_time_in_seconds")
        }
        progress({**values, **counted})

    return later
