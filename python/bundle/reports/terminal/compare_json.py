"""JSON data of `bundle compare`."""

from __future__ import annotations

from typing import Any

from bundle.planning.comparison.comparison_result import GAPS, ComparedProblem, Comparison
from bundle.planning.comparison.measured_run import Measurement, Run
from bundle.planning.comparison.method import Method
from bundle.reports.sections import fields, records
from bundle.reports.terminal.solve_data import solve_options


def comparison_data(comparison: Comparison) -> dict[str, Any]:
    """Return the data of `--json` in addition to the heading."""
    recommendation = comparison.recommendation
    return {
        "inputs": [_input(problem) for problem in comparison.problems],
        "options": solve_options(comparison.options),
        "environment": comparison.environment,
        "perturb": comparison.perturb,
        "seed": comparison.seed,
        "repeat": comparison.repeat,
        "timeout_in_seconds": comparison.timeout,
        "memory_cap_in_bytes": comparison.memory_cap_in_bytes,
        "best_costs": [comparison.best_cost(i) for i in range(len(comparison.problems))],
        "at_minimum": [comparison.is_at_minimum(i) for i in range(len(comparison.problems))],
        "runs": [_run(comparison, run) for run in comparison.runs],
        "profiles": [
            {**fields(profile), "method": _method(profile.method)}
            for profile in comparison.profiles
        ],
        "recommendation": recommendation
        and {
            "method": _method(recommendation.method),
            "reason": recommendation.reason,
            "command": recommendation.command,
            "foreseen": [one and _method(one) for one in recommendation.foreseen],
            "verdict": recommendation.verdict,
        },
        "interrupted": comparison.interrupted,
        "wall_time": {"total": comparison.wall_time_in_seconds},
    }


def _input(problem: ComparedProblem) -> dict[str, Any]:
    counts = fields(problem)
    is_file, name = counts.pop("is_file"), counts.pop("name")
    return {"path": name if is_file else None, **counts}


def _method(method: Method) -> dict[str, Any]:
    return {
        name: value.upper() if isinstance(value, str) else value
        for name, value in fields(method).items()
    }


def _run(comparison: Comparison, run: Run) -> dict[str, Any]:
    return {
        "input": run.problem,
        "method": _method(run.method),
        "outcome": run.outcome.upper(),
        "message": run.message,
        "final_cost": run.final_cost,
        "gap": comparison.gap(run),
        "time_to_gap": [
            {"gap": gap, "time_in_seconds": comparison.time_to_gap(run, gap)} for gap in GAPS
        ],
        "total_time_in_seconds": run.total_time_in_seconds,
        "spread": run.spread,
        "distance_in_sigmas": run.distance_in_sigmas,
        "num_points_elsewhere": run.num_points_elsewhere,
        "minimum": run.minimum if run.minimum >= 0 else None,
        "peak_memory_in_bytes": run.peak_memory_in_bytes or None,
        "prediction": run.prediction,
        "measurements": [_measurement(one) for one in run.measurements],
        "unfinished": run.unfinished and records(run.unfinished),
    }


def _measurement(measurement: Measurement) -> dict[str, Any]:
    added = measurement.added_memory_in_bytes
    return {
        **fields(measurement),
        "total_time_in_seconds": measurement.total_time_in_seconds,
        "time_per_step_in_seconds": measurement.time_per_step_in_seconds,
        "breakdown": measurement.breakdown,
        "added_memory_in_bytes": added if added >= 0 else None,
        "iterations": records(measurement.iterations),
    }
