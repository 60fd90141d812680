"""Comparisons that nobody ran: times and costs as a test wants them."""

from __future__ import annotations

import numpy as np

from bundle.interface.environment import Environment
from bundle.interface.options import SolveOptions
from bundle.planning.comparison.comparison_result import ComparedProblem, Comparison
from bundle.planning.comparison.measured_run import Measurement, Method, Prediction, Run
from tests.reports.terminal import fakes

DENSE = Method(backend="fused", linear_solver_type="dense_schur", num_threads=2)
SPARSE = Method(backend="fused", linear_solver_type="sparse_schur", num_threads=2)
ITERATIVE = Method(backend="fused", linear_solver_type="iterative_schur", num_threads=2)
CERES = Method(backend="ceres", linear_solver_type="dense_schur", num_threads=2)


ENVIRONMENT = Environment(
    date="2026-11-26T05:00:00+00:00",
    cpu_model="AMD EPYC",
    num_cores=2,
    load_before=0.1,
    load_after=1.5,
    versions={"bundle": "0.1.0", "ceres": "2.1.0", "blas": "", "python": "3.11.7"},
)


def measurement(total=1.0, cost=100.0, **changes):
    """A solve that halves its distance to the final cost twice: at 1/2 and at all of its time."""
    iterations = {
        "iteration": np.arange(4),
        "cost": np.array([4.0, 2.0, 0.5, 1.0]) * cost,
        "step_is_successful": np.array([False, True, False, True]),
        "linear_solver_iterations": np.array([0, 3, 4, 5]),
        "cumulative_time_in_seconds": np.array([0.0, 0.5, 0.75, 1.0]) * total,
    }
    values = {
        "summary": fakes.summary(final_cost=cost),
        "iterations": iterations,
        "build_time_in_seconds": 0.0,
        "solve_time_in_seconds": total,
        "peak_memory_in_bytes": 50_000_000,
        "added_memory_in_bytes": 10_000_000,
    }
    return Measurement(**{**values, **changes})


def done(method, total=1.0, cost=100.0, problem=0, **changes):
    return Run(
        problem=problem,
        method=method,
        outcome="done",
        measurements=(measurement(total, cost),),
        **changes,
    )


def failed(method, outcome="timed_out", problem=0, message="stopped after the time-out of 60 s"):
    return Run(problem=problem, method=method, outcome=outcome, message=message)


def comparison(*runs, **changes):
    problems = tuple(
        ComparedProblem(
            name=f"scene {index}.txt",
            is_file=True,
            format="bal",
            num_cameras=3,
            num_images=3,
            num_points=20,
            num_observations=60,
        )
        for index in range(1 + max(run.problem for run in runs))
    )
    values = {
        "problems": problems,
        "runs": runs,
        "profiles": (),
        "recommendation": None,
        "options": SolveOptions(),
        "repeat": 1,
        "timeout": 60.0,
        "memory_cap_in_bytes": 500_000_000,
        "interrupted": False,
        "wall_time_in_seconds": 9.0,
        "environment": ENVIRONMENT,
    }
    return Comparison(**{**values, **changes})


def prediction(**changes):
    values = {
        "ordering": "amd",
        "num_unknowns": 1000,
        "nnz_reduced": 140_000,
        "nnz_factor": 300_000,
        "flops": 2.1e9,
        "memory_in_bytes": 8e6,
        "time_per_step_in_seconds": 0.1,
        "fits_in_memory": True,
    }
    return Prediction(**{**values, **changes})
