"""Wall time of a command by stage."""

from __future__ import annotations

from typing import Any

from bundle.base.records import dataclass
from bundle.base.waiting_time import Waiting
from bundle.base.words import seconds
from bundle.interface.environment import Environment
from bundle.interface.summary import Summary, share, solver_phases
from bundle.reports.sections import Section, Table, fields


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
