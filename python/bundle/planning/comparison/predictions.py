"""Predictions by `bundle.inspect` for the methods of a comparison, and the predicted fastest."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from bundle.errors import InputError
from bundle.interface.options import AUTO_PRECONDITIONER, SolveOptions
from bundle.model.problem import Problem
from bundle.planning.comparison.measured_run import Prediction
from bundle.planning.comparison.method import Method
from bundle.planning.inspection.inspection_result import Inspection, MethodInspection
from bundle.planning.inspection.problem_inspection import inspect
from bundle.solving.solve import solve


def predict(
    problem: Problem, options: SolveOptions, methods: Iterable[Method]
) -> dict[Method, Prediction]:
    """Return the predictions by method.

    Methods without an inspection have no prediction. If the inspection refuses the options, all
    predictions are missing; the runs then report the reason.
    """
    methods = tuple(methods)
    found: dict[Method, Prediction] = {}
    for num_threads in {method.num_threads for method in methods}:
        try:
            inspection = inspect(problem, options, num_threads=num_threads)
        except (InputError, MemoryError):
            continue
        for method in methods:
            match = _match(method, inspection) if method.num_threads == num_threads else None
            if match is not None:
                found[method] = _prediction(match, inspection)
    return found


def _match(method: Method, inspection: Inspection) -> MethodInspection | None:
    """Return the inspection of a method; of several orders, the cheapest."""
    fitting = [one for one in inspection.methods if one.is_taken and _is_that(method, one)]
    return min(fitting, key=lambda one: one.flops, default=None)


def _is_that(method: Method, inspected: MethodInspection) -> bool:
    same = (method.linear_solver_type, method.backend) == (
        inspected.linear_solver_type.lower(),
        inspected.backend.lower(),
    )
    cameras_first = inspected.ordering == "cameras_first"
    if not same or method.linear_solver_ordering != (
        "cameras_first" if cameras_first else "points_first"
    ):
        return False
    if method.is_iterative:
        wanted = method.preconditioner_type
        if wanted == "auto":
            wanted = AUTO_PRECONDITIONER[method.backend, method.linear_solver_type]
        return inspected.preconditioner.lower() == wanted
    return True


def _prediction(inspected: MethodInspection, inspection: Inspection) -> Prediction:
    columns = inspection.num_camera_columns
    reduces = "SCHUR" in inspected.linear_solver_type and inspected.ordering != "cameras_first"
    return Prediction(
        ordering=inspected.ordering if inspected.linear_solver_type.startswith("SPARSE") else "",
        num_unknowns=columns if reduces else inspected.num_unknowns,
        nnz_reduced=round(inspection.reduced_density * columns**2) if reduces else 0,
        nnz_factor=inspected.nnz_factor,
        flops=inspected.flops,
        memory_in_bytes=inspected.memory_in_bytes,
        time_per_step_in_seconds=inspected.time_per_step_in_seconds,
        fits_in_memory=inspected.fits_in_memory,
        note=inspected.note,
    )


def foresee(
    problem: Problem,
    options: SolveOptions,
    methods: Sequence[Method],
    predictions: Mapping[Method, Prediction],
    memory_cap: int = 0,
) -> Method | None:
    """Return the method that is predicted to be the fastest, without solving.

    With predicted times, it is the fastest method that fits into memory and under the cap (bytes
    beyond the problem; 0: no cap). Otherwise it is the choice of ``auto`` with the most threads, or
    None if that choice is not among the methods.
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
    """Return the backend and linear solver that ``auto`` chooses; None if these options fail.

    The choice comes from a solve without steps, which also evaluates the start.
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
    if summary.interrupted:  # a solve handles Ctrl-C itself
        raise KeyboardInterrupt
    return Method(
        backend=summary.backend_used.lower(),
        linear_solver_type=summary.linear_solver_type_used.lower(),
        num_threads=num_threads,
    )
