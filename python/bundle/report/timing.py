"""Where the time went: inside Ceres by phase, outside it by stage."""

from __future__ import annotations

from dataclasses import dataclass

from rich.table import Table

from bundle.report.text import columns, seconds
from bundle.result import Summary

__all__ = ["WallTime", "solver_phases", "solver_table", "wall_table"]


@dataclass(frozen=True, kw_only=True)
class WallTime:
    """Wall-clock seconds of a command by stage; ``total`` also holds what no stage names."""

    load: float
    build: float
    solve: float
    save: float
    total: float


def solver_phases(summary: Summary) -> list[tuple[str, float]]:
    """Return (phase, seconds) of a solve, -1 where Ceres did not measure.

    Ceres' evaluation and linear solver times are parts of its minimizer time and do not add up to
    it: "other" is what is left of the total, so that the phases do add up.
    """
    phases = [
        ("preprocessor", summary.preprocessor_time_in_seconds),
        ("residual evaluation", summary.residual_evaluation_time_in_seconds),
        ("Jacobian evaluation", summary.jacobian_evaluation_time_in_seconds),
        ("linear solver", summary.linear_solver_time_in_seconds),
    ]
    post = summary.postprocessor_time_in_seconds
    total = summary.total_time_in_seconds
    measured = sum(max(time, 0.0) for _, time in phases) + max(post, 0.0)
    other = max(total - measured, 0.0) if total >= 0 else -1.0
    return [*phases, ("other", other), ("postprocessor", post)]


def solver_table(summary: Summary) -> Table:
    """Return the phases of a solve with their share of it."""
    total = summary.total_time_in_seconds
    rows = [(name, seconds(time), _share(time, total)) for name, time in solver_phases(summary)]
    rows.append(("total", seconds(total), _share(total, total)))
    return columns(("time", "seconds", "share"), rows)


def wall_table(summary: Summary, wall: WallTime) -> Table:
    """Return the stages of a command, the phases of the solve among them, with their shares."""
    total, solver = wall.total, summary.total_time_in_seconds
    rows = [_stage("load", wall.load, total), _stage("build", wall.build, total)]
    rows.append(("solve", seconds(wall.solve), "", _share(wall.solve, total)))
    rows += [
        (f"  {name}", seconds(time), _share(time, solver), _share(time, total))
        for name, time in solver_phases(summary)
    ]
    rows.append(_stage("save", wall.save, total))
    rest = total - wall.load - wall.build - wall.solve - wall.save
    rows.append(_stage("everything else", max(rest, 0.0), total))
    rows.append(_stage("total", total, total))
    return columns(("time", "seconds", "of the solve", "of all"), rows)


def _stage(name: str, time: float, total: float) -> tuple[str, str, str, str]:
    return name, seconds(time), "", _share(time, total)


def _share(time: float, total: float) -> str:
    return f"{100.0 * time / total:.1f} %" if time >= 0 and total > 0 else "-"
