"""What `bundle compare` tells programs."""

from __future__ import annotations

import dataclasses
from typing import Any

from bundle._core import __version__
from bundle.planning.comparison.comparison_result import (
    GAPS,
    ComparedProblem,
    Comparison,
    Measurement,
    Run,
)
from bundle.planning.comparison.method import Method
from bundle.reports.terminal import json

__all__ = ["as_json"]


def as_json(comparison: Comparison) -> dict[str, Any]:
    """Return the report of `bundle compare` for programs.

    Summaries and iterations are those of `bundle refine`; ``input`` in a run counts ``inputs`` from
    0. Costs are 1/2 sum rho(||r||^2), r in pixels; what is not known is None.
    """
    recommendation = comparison.recommendation
    report: dict[str, Any] = json.plain(
        {
            "schema": json.SCHEMA,
            "command": "compare",
            "version": __version__,
            "inputs": [_input(problem) for problem in comparison.problems],
            "options": json.solve_options(comparison.options),
            "repeat": comparison.repeat,
            "timeout_in_seconds": comparison.timeout,
            "memory_cap_in_bytes": comparison.memory_cap_in_bytes,
            "best_costs": [comparison.best_cost(i) for i in range(len(comparison.problems))],
            "runs": [_run(comparison, run) for run in comparison.runs],
            "profiles": [
                {**dataclasses.asdict(profile), "method": _method(profile.method)}
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
    )
    return report


def _input(problem: ComparedProblem) -> dict[str, Any]:
    counts = dataclasses.asdict(problem)
    is_file, name = counts.pop("is_file"), counts.pop("name")
    return {"path": name if is_file else None, **counts}


def _method(method: Method) -> dict[str, Any]:
    return {
        name: value.upper() if isinstance(value, str) else value
        for name, value in dataclasses.asdict(method).items()
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
        "peak_memory_in_bytes": run.peak_memory_in_bytes or None,
        "prediction": run.prediction and dataclasses.asdict(run.prediction),
        "measurements": [_measurement(one) for one in run.measurements],
        "unfinished": run.unfinished and json.records(run.unfinished),
    }


def _measurement(measurement: Measurement) -> dict[str, Any]:
    return {
        "total_time_in_seconds": measurement.total_time_in_seconds,
        "build_time_in_seconds": measurement.build_time_in_seconds,
        "solve_time_in_seconds": measurement.solve_time_in_seconds,
        "time_per_step_in_seconds": measurement.time_per_step_in_seconds,
        "breakdown": measurement.breakdown,
        "peak_memory_in_bytes": measurement.peak_memory_in_bytes,
        "added_memory_in_bytes": (
            measurement.added_memory_in_bytes if measurement.added_memory_in_bytes >= 0 else None
        ),
        "summary": dataclasses.asdict(measurement.summary),
        "iterations": json.records(measurement.iterations),
    }
