"""Results that no solver made: every field of a summary, and what a test changes in it."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from bundle.interface.options import SolveOptions
from bundle.interface.summary import Summary
from bundle.model.problem import Problem
from bundle.model.residuals import ReprojectionError, worst_images
from bundle.solving.kept_errors import KeptErrors
from bundle.solving.result import Result

CONVERGED = Summary(
    initial_cost=4.185659518e6,
    final_cost=1.803390348e4,
    fixed_cost=0.0,
    termination_type="CONVERGENCE",
    message="Function tolerance reached. |cost_change|/cost: 3.4e-07 <= 1.0e-06",
    is_solution_usable=True,
    num_successful_steps=8,
    num_unsuccessful_steps=1,
    num_parameter_blocks=22122,
    num_parameters=66510,
    num_residual_blocks=83718,
    num_residuals=167436,
    num_parameter_blocks_reduced=22121,
    num_parameters_reduced=66501,
    num_residual_blocks_reduced=83717,
    num_residuals_reduced=167434,
    trust_region_strategy_type="LEVENBERG_MARQUARDT",
    dogleg_type="TRADITIONAL_DOGLEG",
    linear_solver_type_given="DENSE_SCHUR",
    linear_solver_type_used="DENSE_SCHUR",
    linear_solver_ordering_given=(22106, 16),
    linear_solver_ordering_used=(22106, 16),
    schur_structure_given="2,3,9",
    schur_structure_used="2,3,9",
    preconditioner_type_given="SCHUR_JACOBI",
    preconditioner_type_used="IDENTITY",
    dense_linear_algebra_library_type="LAPACK",
    sparse_linear_algebra_library_type="SUITE_SPARSE",
    num_threads_given=2,
    num_threads_used=2,
    preprocessor_time_in_seconds=0.25,
    residual_evaluation_time_in_seconds=0.0625,
    jacobian_evaluation_time_in_seconds=0.125,
    linear_solver_time_in_seconds=0.25,
    minimizer_time_in_seconds=0.625,
    postprocessor_time_in_seconds=0.0625,
    total_time_in_seconds=1.0,
    num_residual_evaluations=9,
    num_jacobian_evaluations=8,
    num_linear_solves=9,
    backend_given="CERES",
    backend_used="CERES",
    backend_choice="",
    instruction_set="",
    linear_solver_choice="16 images make a small reduced camera matrix.",
    interrupted=False,
    warnings=(),
    warning_kinds=(),
    num_information_nonzeros=4721598,
    num_factor_columns=144,
    num_reduced_nonzeros=20736,
    num_factor_nonzeros=10440,
    factor_flops=1.015872e6,
    factor_ordering="natural",
    symbolic_time_in_seconds=0.0,
)

OPTIONS = SolveOptions(linear_solver_type="dense_schur", num_threads=2, gauge="none")


def summary(**changes: Any) -> Summary:
    return dataclasses.replace(CONVERGED, **changes)


def iterations() -> dict[str, np.ndarray]:
    return {
        "iteration": np.array([0, 1, 2], np.int32),
        "cost": np.array([3.0, 2.0, 2.0]),
        "cost_change": np.array([0.0, 1.0, np.nan]),
        "gradient_max_norm": np.array([9.0, 4.0, 4.0]),
        "step_norm": np.array([0.0, 1.0, 0.5]),
        "relative_decrease": np.array([0.0, 0.9, -np.inf]),
        "trust_region_radius": np.array([1e4, 3e4, 1.5e4]),
        "linear_solver_iterations": np.array([0, 1, 1], np.int32),
        "step_is_successful": np.array([True, True, False]),
        "iteration_time_in_seconds": np.array([0.1, 0.1, 0.1]),
        "cumulative_time_in_seconds": np.array([0.1, 0.2, 0.3]),
    }


def error(scale: float, behind: int = 0) -> ReprojectionError:
    return ReprojectionError(
        rmse=4 * scale,
        mean=3 * scale,
        median=2 * scale,
        p95=8 * scale,
        max=9 * scale,
        num_observations=83718,
        num_behind_camera=behind,
    )


def result(problem: Problem, **changes: Any) -> Result:
    values: dict[str, Any] = {
        "problem": problem,
        "initial_problem": problem,
        "options": OPTIONS,
        "summary": CONVERGED,
        "iterations": iterations(),
        "build_time_in_seconds": 0.125,
        "solve_time_in_seconds": 1.0,
    }
    made = Result(**{**values, **changes})
    # As if measured already: what a property has found is kept beside the fields.
    before, after = error(2.5, behind=31), error(0.25)
    vars(made).update(
        reprojection_error_before=before,
        reprojection_error_after=after,
        worst_images=worst_images(problem),
        kept=KeptErrors(before=before, after=after, num_observations=83718),
    )
    return made
