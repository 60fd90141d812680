"""What a solve gives back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.options import SolveOptions
from bundle.problem import Problem

__all__ = ["ReprojectionError", "Result", "Summary"]


@dataclass(frozen=True, kw_only=True)
class ReprojectionError:
    """Reprojection errors ||r|| over the observations that have one, in pixels.

    ``rmse`` is sqrt(mean ||r||^2). Observations behind their camera, and those whose projection
    does not exist, are counted and, unless ``cheirality`` is "algebraic", left out of the
    statistics. Every number is NaN where there is no observation.
    """

    rmse: float
    mean: float
    median: float
    p95: float
    max: float
    num_observations: int
    num_behind_camera: int


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Ceres' Solver::Summary under Ceres' field names; times in seconds, -1 where not measured.

    Beyond Ceres: ``linear_solver_choice`` (why ``auto`` took this solver; "" when asked for),
    ``warnings`` (sentences: a fallback, a gauge that could not be held, ...), ``interrupted``.
    Costs are 1/2 sum rho(||r||^2), r in pixels.
    """

    initial_cost: float
    final_cost: float
    fixed_cost: float
    termination_type: str
    message: str
    is_solution_usable: bool
    num_successful_steps: int
    num_unsuccessful_steps: int
    num_parameter_blocks: int
    num_parameters: int
    num_residual_blocks: int
    num_residuals: int
    num_parameter_blocks_reduced: int
    num_parameters_reduced: int
    num_residual_blocks_reduced: int
    num_residuals_reduced: int
    trust_region_strategy_type: str
    dogleg_type: str
    linear_solver_type_given: str
    linear_solver_type_used: str
    linear_solver_ordering_given: tuple[int, ...]
    linear_solver_ordering_used: tuple[int, ...]
    schur_structure_given: str
    schur_structure_used: str
    preconditioner_type_given: str
    preconditioner_type_used: str
    dense_linear_algebra_library_type: str
    sparse_linear_algebra_library_type: str
    num_threads_given: int
    num_threads_used: int
    preprocessor_time_in_seconds: float
    residual_evaluation_time_in_seconds: float
    jacobian_evaluation_time_in_seconds: float
    linear_solver_time_in_seconds: float
    minimizer_time_in_seconds: float
    postprocessor_time_in_seconds: float
    total_time_in_seconds: float
    num_residual_evaluations: int
    num_jacobian_evaluations: int
    num_linear_solves: int
    linear_solver_choice: str
    interrupted: bool
    warnings: tuple[str, ...]

    def full_report(self) -> str:
        """Return everything in lines of text, in the order of Ceres' FullReport."""
        from bundle.report import summary as report

        return report.full_report(self)

    def breakdown(self) -> str:
        """Return the table of where the time inside the solver went, with percentages."""
        from bundle.report import summary as report

        return report.breakdown(self)


@dataclass(frozen=True, eq=False, kw_only=True)
class Result:
    """A refined problem and how it came about.

    Attributes:
        problem: the refined problem; the input is untouched.
        options: every option as used.
        summary: what the solver says.
        iterations: one array a field of Ceres' IterationSummary, one entry an iteration.
        reprojection_error_before: pixels, at the input.
        reprojection_error_after: pixels, at the output.
        build_time_in_seconds: from the arrays to a Ceres problem and back, outside Ceres.
        solve_time_in_seconds: inside Ceres.
    """

    problem: Problem
    options: SolveOptions
    summary: Summary
    iterations: dict[str, NDArray[np.generic]]
    reprojection_error_before: ReprojectionError
    reprojection_error_after: ReprojectionError
    build_time_in_seconds: float
    solve_time_in_seconds: float

    def asdict(self) -> dict[str, Any]:
        """Return options, summary, iterations and errors as the JSON report has them."""
        from bundle.report import json as report

        return report.result(self)
