"""The two loops in the report of `bundle vio --publish`."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from bundle.base.words import number, plural
from bundle.inertial.two_loops.replay import TwoLoopsResult
from bundle.inertial.vio.trajectory_comparison import TrajectoryError
from bundle.reports.sections import Report, Section


def with_loops(
    report: Report, result: TwoLoopsResult, error: TrajectoryError | None, written: str | None
) -> Report:
    """Return the report of an odometry, extended by that of its two loops.

    Args:
        report: report of the odometry.
        result: result of both loops.
        error: error of the published poses against the truth; None without a truth.
        written: path of the published poses; None if they were not written.
    """
    return replace(
        report,
        headline=[*report.headline, _published(result, error)],
        sections=[*report.sections, _section(result, error)],
        data={**report.data, "two_loops": _data(result, error, written)},
    )


def _published(result: TwoLoopsResult, error: TrajectoryError | None) -> str:
    """Return the published poses and their error in a sentence."""
    found = result.statistics
    late = "" if found.lateness is None else f", {found.num_late:,} late by more than 5 ms"
    accuracy = "" if error is None else f"; error {number(error.ate)} m rms (ATE)"
    closures = plural(found.num_closures, "closure")
    return f"Published {found.num_poses:,} poses with {closures}{late}{accuracy}."


def _section(result: TwoLoopsResult, error: TrajectoryError | None) -> Section:
    """Return latency of poses, corrections by closures, and losses."""
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
    return Section(facts=rows, is_detail=True)


def _data(
    result: TwoLoopsResult, error: TrajectoryError | None, written: str | None
) -> dict[str, Any]:
    """Return the entry ``two_loops`` of the report for programs."""
    motion = result.correction
    return {
        **result.statistics.asdict(),
        "correction": {"yaw": motion.yaw, "translation": motion.shift},
        "error": error,
        "output": None if written is None else {"path": written, "format": "tum"},
    }
