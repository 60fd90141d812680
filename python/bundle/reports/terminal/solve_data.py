"""Report parts that several kinds of input share."""

from __future__ import annotations

import dataclasses
from typing import Any

from bundle.base.words import number, plural, seconds
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.summary import Summary
from bundle.reports.sections import Column, records
from bundle.solving.result import Result

_full = "{:.9e}".format

ROUNDS = (
    Column("round", "round"),
    Column("cost before", "initial_cost", _full),
    Column("cost after", "cost", _full),
    Column("observations", "num_observations"),
    Column("removed", "num_observations_removed"),
    Column("points", "num_points"),
    Column("removed", "num_points_removed"),
)
ERRORS = {
    "rmse": "RMSE [px]",
    "mean": "mean error [px]",
    "median": "median error [px]",
    "p95": "95th percentile [px]",
    "max": "max error [px]",
}


def result_data(solved: Result) -> dict[str, Any]:
    """Return options, summary, iterations and reprojection errors of a solve."""
    return {
        "options": solve_options(solved.options),
        "summary": solved.summary,
        "iterations": records(solved.iterations),
        "reprojection_error": {
            "before": solved.reprojection_error_before,
            "after": solved.reprojection_error_after,
            "kept": solved.kept,
        },
    }


def solve_options(options: SolveOptions | PoseGraphOptions) -> dict[str, Any]:
    """Return all options by name, enumerations in upper case."""
    values = options.asdict()
    for field in dataclasses.fields(options):
        if field.metadata["choices"] is not None:
            values[field.name] = values[field.name].upper()
    return values


def factor_fact(summary: Summary) -> list[tuple[str, str]]:
    """Return the size and cost of the factor; empty without a factorisation."""
    if summary.num_factor_nonzeros is None:
        return []
    words = (
        f"{plural(summary.num_factor_columns or 0, 'column')}, {summary.factor_ordering} order, "
        f"{number(summary.num_factor_nonzeros)} nonzeros, "
        f"{number(summary.factor_flops or 0.0)} flops, analysed in "
        f"{seconds(summary.symbolic_time_in_seconds or 0.0)} s"
    )
    return [("factor", words)]
