"""What `bundle.inspect` foresees of each method, in the terms of a comparison."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Sequence
from typing import Any

from bundle.comparison.method import Method
from bundle.comparison.result import Prediction
from bundle.options import SolveOptions
from bundle.problem import Problem

__all__ = ["predict"]


def predict(
    problem: Problem, options: SolveOptions, methods: Iterable[Method]
) -> dict[Method, Prediction]:
    """Return the predictions there are; a method that inspection does not know has none."""
    methods = tuple(methods)
    found: dict[Method, Prediction] = {}
    try:
        inspect = importlib.import_module("bundle.inspection").inspect
    except (ImportError, AttributeError):
        return found
    for num_threads in {method.num_threads for method in methods}:
        inspected = inspect(problem, options, num_threads=num_threads).methods
        for method in methods:
            match = _match(method, inspected) if method.num_threads == num_threads else None
            if match is not None:
                found[method] = _prediction(match)
    return found


def _match(method: Method, inspected: Sequence[Any]) -> Any | None:
    """Return the inspection of a method; where several orders come into question, the cheapest."""
    if method.linear_solver_ordering != "points_first":
        return None
    fitting = [one for one in inspected if _fits(method, one)]
    return min(fitting, key=lambda one: one.flops, default=None)


def _fits(method: Method, inspected: Any) -> bool:
    if inspected.linear_solver_type.lower() != method.linear_solver_type:
        return False
    if inspected.backend.lower() != method.backend:
        return False
    if method.linear_solver_type == "sparse_schur":
        orders = ("amd", "metis") if method.backend == "fused" else ("amd",)
        return str(inspected.ordering).lower() in orders
    if method.is_iterative:
        wanted = method.preconditioner_type
        if wanted == "auto":
            wanted = "schur_jacobi" if method.linear_solver_type == "iterative_schur" else "jacobi"
        return str(inspected.preconditioner).lower() == wanted
    return True


def _prediction(inspected: Any) -> Prediction:
    return Prediction(
        ordering=inspected.ordering.lower() if inspected.nnz_factor else "",
        num_unknowns=inspected.num_unknowns,
        nnz_reduced=_number(inspected.nnz_reduced),
        nnz_factor=_number(inspected.nnz_factor),
        flops=_number(inspected.flops),
        memory_in_bytes=_number(inspected.memory_in_bytes),
        time_per_step_in_seconds=_number(inspected.time_per_step_in_seconds),
        fits_in_memory=inspected.fits_in_memory,
        note=inspected.note,
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
