"""Report parts that several kinds of input share, and wall time by stage."""

from __future__ import annotations

import dataclasses
from typing import Any

from bundle.base.records import dataclass
from bundle.base.waiting_time import Waiting
from bundle.base.words import number, plural, seconds
from bundle.interface.environment import Environment
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.summary import Summary, share, solver_phases
from bundle.reports.sections import Column, Section, Table, fields, records
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


@dataclass(frozen=True, kw_only=True)
class WallTime:
    """Wall-clock seconds of a command by stage; ``total`` includes time outside all stages.

    ``statistics`` is the time for reprojection errors before and after, if a command computes them.
    """

    load: float
    build: float
    solve: float
    save: float
    statistics: float = 0.0
    total: float


def environment_data(waiting: Waiting | None) -> dict[str, Any]:
    """Return machine, load and versions at the end of a command, and its waiting for cores."""
    waited = {} if waiting is None else fields(waiting)
    return {**fields(Environment.now().finished()), **waited}


def wall_section(summary: Summary, wall: WallTime) -> Section:
    """Return the stages of a command, including the phases of the solve, with their shares."""
    total, solver = wall.total, summary.total_time_in_seconds
    rows = [_stage("load", wall.load, total), _stage("build", wall.build, total)]
    rows.append(("solve", seconds(wall.solve), "", share(wall.solve, total)))
    rows += [
        (f"  {name}", seconds(time), share(time, solver), share(time, total))
        for name, time in solver_phases(summary)
    ]
    rows.append(_stage("save", wall.save, total))
    if wall.statistics > 0:
        rows.append(_stage("statistics", wall.statistics, total))
    rest = total - wall.load - wall.build - wall.solve - wall.save - wall.statistics
    rows.append(_stage("everything else", max(rest, 0.0), total))
    rows.append(_stage("total", total, total))
    return Section(tables=[Table.of(("time", "seconds", "of the solve", "of all"), rows)])


def _stage(name: str, time: float, total: float) -> tuple[str, str, str, str]:
    return name, seconds(time), "", share(time, total)
