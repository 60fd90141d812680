"""Which method to take before anything is measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.comparison.comparison_result import Prediction
from bundle.planning.comparison.method import Method
from bundle.solving.solver import solve

__all__ = ["foresee", "taken_by_auto"]


def foresee(
    problem: Problem,
    options: SolveOptions,
    methods: Sequence[Method],
    predictions: Mapping[Method, Prediction],
    memory_cap: int = 0,
) -> Method | None:
    """Return which of the methods will be the fastest, by all that is known without solving.

    Where times are predicted, the least of those that fit into memory and under the cap (bytes
    beyond the problem, 0 for none); otherwise what ``auto`` takes, with the most threads; None if
    that is not among the methods.
    """
    times = {
        method: predictions[method].time_per_step_in_seconds
        for method in methods
        if method in predictions and _fits(predictions[method], memory_cap)
    }
    times = {method: time for method, time in times.items() if math.isfinite(time)}
    if times:
        return min(times, key=lambda method: times[method])
    most = max(method.num_threads for method in methods)
    taken = taken_by_auto(problem, options, most)
    return taken if taken in methods else None


def _fits(prediction: Prediction, memory_cap: int) -> bool:
    within = not memory_cap or prediction.memory_in_bytes <= memory_cap
    return prediction.fits_in_memory and within


def taken_by_auto(problem: Problem, options: SolveOptions, num_threads: int) -> Method | None:
    """Return what ``auto`` takes for backend and linear solver; None if these options fail.

    It is asked for no step, so that it chooses, evaluates the start, and ends.
    """
    asked = options.replace(
        backend="auto",
        linear_solver_type="auto",
        preconditioner_type="auto",
        linear_solver_ordering="points_first",
        num_threads=num_threads,
        max_num_iterations=0,
    )
    try:
        summary = solve(problem, asked).summary
    except (InputError, MemoryError):
        return None
    if summary.interrupted:  # a solve takes Ctrl-C for itself
        raise KeyboardInterrupt
    return Method(
        backend=summary.backend_used.lower(),
        linear_solver_type=summary.linear_solver_type_used.lower(),
        num_threads=num_threads,
    )
