"""What `bundle vio --publish` says of its loops."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from rich.console import RenderableType

from bundle.base.tables import facts
from bundle.base.words import number, plural
from bundle.inertial.two_loops.replay import TwoLoopsResult
from bundle.inertial.vio.trajectory_comparison import TrajectoryError
from bundle.reports.terminal import json

__all__ = ["loop_tables", "loops_as_json"]


def loop_tables(result: TwoLoopsResult, error: TrajectoryError | None) -> list[RenderableType]:
    """Return how late poses were, what closures corrected, what the loops left out."""
    found, motion = result.statistics, result.correction
    rows = [("published", f"{plural(found.num_poses, 'pose')}, one per IMU sample")]
    if found.lateness is not None:
        p50, p95, most = (number(1e3 * found.lateness[key]) for key in ("p50", "p95", "max"))
        rows.append(
            (
                "late",
                f"{p50} ms (median), {p95} (p95), {most} (max); {found.num_late} by more than 5 ms",
            )
        )
    rows += [
        (
            "window",
            f"{plural(found.num_window_solves, 'solve')}, {found.num_window_late} late; "
            f"{plural(found.num_images_left_out, 'image')} left out",
        ),
        (
            "closures",
            f"{found.num_closures} used, {found.num_closures_unknown} without keyframes; "
            f"{plural(found.num_graph_solves, 'solve')} of the graph",
        ),
        (
            "corrections",
            f"{found.num_corrections}, in all {number(math.degrees(motion.yaw))} degrees; at most "
            f"{number(found.largest_shift)} m and "
            f"{number(math.degrees(found.largest_turn))} degrees per pose",
        ),
        ("lost", f"{found.num_lost} by full rings, {found.num_solutions_refused} too old"),
    ]
    if error is not None:
        rows.append(("corrected", f"{number(error.ate)} m rms (ATE) of the published poses"))
    return ["", facts(rows)]


def loops_as_json(
    result: TwoLoopsResult, error: TrajectoryError | None, written: str | None
) -> dict[str, Any]:
    """Return ``two_loops`` of the report."""
    report: dict[str, Any] = json.plain(
        {
            **result.statistics.asdict(),
            "correction": {
                "yaw": result.correction.yaw,
                "translation": result.correction.shift.tolist(),
            },
            "error": None if error is None else asdict(error),
            "output": None if written is None else {"path": written, "format": "tum"},
        }
    )
    return report
