"""Comparisons that nobody ran: two problems, seven methods, every outcome."""

from __future__ import annotations

import dataclasses

import numpy as np

from bundle.interface.options import SolveOptions
from bundle.planning.comparison.comparison_result import (
    GAPS,
    ComparedProblem,
    Comparison,
    PerformanceProfile,
    Recommendation,
)
from bundle.planning.comparison.measured_run import Measurement, Method, Prediction, Run
from tests.planning.comparison.fakes import ENVIRONMENT
from tests.reports.terminal.fakes import summary

HOSTILE = "a</script><script>document.title='owned'</script>&<b>$\\frac$.txt"

METHODS = tuple(
    Method(
        backend=backend, linear_solver_type=solver, preconditioner_type=conditioner, num_threads=2
    )
    for backend, solver, conditioner in [
        ("fused", "sparse_schur", "auto"),
        ("fused", "dense_schur", "auto"),
        ("fused", "iterative_schur", "schur_jacobi"),
        ("ceres", "sparse_schur", "auto"),
        ("ceres", "dense_schur", "auto"),
        ("ceres", "iterative_schur", "cluster_jacobi"),
        ("ceres", "sparse_normal_cholesky", "auto"),
    ]
)
SPEEDS = (0.11, 0.31, 0.19, 0.4, 0.9, 0.7, 2.5)
COLUMNS = {
    "iteration": int,
    "step_is_successful": bool,
    "cumulative_time_in_seconds": float,
    "cost": float,
}


def iterations(seconds_per_step: float, num_steps: int, best: float) -> dict[str, np.ndarray]:
    steps = np.arange(num_steps)
    costs = best * (1 + 30 * np.exp(-0.9 * steps))
    costs[3] *= 2  # a rejected step
    accepted = steps != 3
    rows = (steps, accepted, seconds_per_step * (steps + 0.3), costs)
    return {
        name: np.array(row, kind) for (name, kind), row in zip(COLUMNS.items(), rows, strict=True)
    }


def measurement(seconds_per_step: float, best: float) -> Measurement:
    trace = iterations(seconds_per_step, 22, best)
    total = 22.5 * seconds_per_step
    done = summary(
        final_cost=float(trace["cost"][-1]),
        residual_evaluation_time_in_seconds=0.1 * total,
        jacobian_evaluation_time_in_seconds=0.3 * total,
        linear_solver_time_in_seconds=0.5 * total,
        minimizer_time_in_seconds=0.98 * total,
        num_linear_solves=21,
    )
    return Measurement(
        summary=done,
        iterations=trace,
        build_time_in_seconds=0.1 * seconds_per_step,
        solve_time_in_seconds=total,
        peak_memory_in_bytes=int(4e8),
        added_memory_in_bytes=int(2.5e8),
    )


def prediction(seconds_per_step: float) -> Prediction:
    return Prediction(
        ordering="amd",
        num_unknowns=8820,
        nnz_reduced=1.1e6,
        nnz_factor=2.3e6,
        flops=2.1e9,
        memory_in_bytes=2.4e8,
        time_per_step_in_seconds=1.2 * seconds_per_step,
        fits_in_memory=True,
    )


def run(problem: int, index: int) -> Run:
    """The fifth method runs out of memory, the last is stopped half-way, on the second problem."""
    method, pace = METHODS[index], SPEEDS[index] * (1 + 0.6 * problem * (index % 3))
    if problem == 1 and index == 4:
        message = "it took more than 500 MB: DENSE_SCHUR needs 622 MB for S."
        unfit = dataclasses.replace(prediction(pace), fits_in_memory=False, note="S does not fit")
        return Run(
            problem=1, method=method, outcome="out_of_memory", message=message, prediction=unfit
        )
    if problem == 1 and index == 6:
        return Run(
            problem=1,
            method=method,
            outcome="timed_out",
            message="stopped after 20 seconds.",
            unfinished=iterations(pace, 8, 2e4),
            prediction=prediction(pace),
        )
    return Run(
        problem=problem,
        method=method,
        outcome="done",
        measurements=(measurement(pace, 1e4 * (1 + problem + 1e-7 * index)),),
        prediction=prediction(pace),
    )


def comparison(num_problems: int = 2, name: str = "street-980.txt") -> Comparison:
    problems = tuple(
        ComparedProblem(
            name=shown,
            format="bal",
            is_file=True,
            num_cameras=980 * (index + 1),
            num_images=980 * (index + 1),
            num_points=107_000,
            num_observations=512_034,
        )
        for index, shown in enumerate([name, HOSTILE][:num_problems])
    )
    runs = tuple(run(p, m) for p in range(num_problems) for m in range(len(METHODS)))
    made = Comparison(
        problems=problems,
        runs=runs,
        profiles=(),
        recommendation=Recommendation(
            method=METHODS[0],
            reason="fused SPARSE_SCHUR: S is 14 % full, AMD needs 2.1e9 flops per step; "
            "DENSE_SCHUR takes 3.1 times as long.",
            command="bundle refine street-980.txt -o refined.txt --solver sparse-schur",
            foreseen=(METHODS[0],) * num_problems,
            verdict="`bundle inspect` predicted a method within 5 % of the fastest on 2 of 2 "
            "problems.",
        ),
        options=SolveOptions(),
        repeat=1,
        timeout=120.0,
        memory_cap_in_bytes=int(2e9),
        interrupted=False,
        wall_time_in_seconds=77.0,
        environment=ENVIRONMENT,
    )
    return dataclasses.replace(made, profiles=profiles(made) if num_problems > 1 else ())


def profiles(made: Comparison) -> tuple[PerformanceProfile, ...]:
    found = []
    for gap in GAPS:
        times = np.array(
            [
                [made.time_to_gap(one, gap) for one in made.runs_of(p)]
                for p in range(len(made.problems))
            ]
        )
        ratios = times / np.nanmin(times, axis=1, keepdims=True)
        for method, own in zip(made.methods, ratios.T, strict=True):
            sound = tuple(sorted(float(ratio) for ratio in own if np.isfinite(ratio)))
            found.append(
                PerformanceProfile(
                    method=method, gap=gap, ratios=sound, num_problems=len(made.problems)
                )
            )
    return tuple(found)
