"""Report of `bundle vio`, and of its two loops."""

from __future__ import annotations

import json
import math
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from bundle.base.waiting_time import Waiting
from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.inertial.tracking.track_recording import Tracking
from bundle.inertial.two_loops.replay import TwoLoopsResult
from bundle.inertial.vio.keyframe_record import KeyframeRecord, alarms_by_kind
from bundle.inertial.vio.odometry import OdometryResult
from bundle.inertial.vio.trajectory_comparison import TrajectoryError
from bundle.interface.finding import Finding
from bundle.model.content_digests import content_digests
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import SequenceFinding
from bundle.reports.sections import Report, Section, Table, plain
from bundle.reports.terminal.inputs import about_sequence
from bundle.reports.terminal.solve_data import environment_data
from bundle.reports.terminal.tracking import tracking_headline, tracking_section


def odometry_report(
    source: str,
    format: str,
    sequence: Sequence,
    result: OdometryResult,
    error: TrajectoryError | None,
    written: str | None,
    wall_time: float,
    findings: tuple[SequenceFinding | Finding, ...] = (),
    waiting: Waiting | None = None,
    tracking: Tracking | None = None,
) -> Report:
    """Return start, keyframes, times, alarms, and errors if there is a truth.

    Args:
        source: path of the sequence.
        format: format of the sequence.
        sequence: the sequence before the odometry.
        result: result of the odometry.
        error: error against the truth; None without a truth.
        written: path of the trajectory; None if it was not written.
        wall_time: seconds.
        findings: suspicious properties of the sequence; they precede the alarms.
        waiting: time in which others held the cores.
        tracking: statistics of tracking; None if the sequence has tracks.
    """
    said = _warnings(result, findings)
    return Report(
        command="vio",
        input={
            **about_sequence(source, format, sequence),
            "duration": sequence.duration,
            "digests": content_digests(sequence),
        },
        headline=[
            *_headline(result, error),
            *([] if tracking is None else [tracking_headline(tracking)]),
        ],
        warnings=said,
        sections=[
            *([] if written is None else [Section(facts=[("output", f"{shown(written)} (TUM)")])]),
            *([Section(facts=asked)] if (asked := _certainty(result.keyframes)) else []),
            Section(facts=odometry_facts(source, result, error), is_detail=True),
            *([] if tracking is None else [tracking_section(sequence, tracking)]),
            Section(tables=[_times(result)], is_detail=True),
        ],
        data={
            "options": result.options.asdict(),
            "summary": {
                "start": result.start,
                "is_solution_usable": result.is_usable,
                "interrupted": result.interrupted,
                "message": result.message,
                "num_images": result.num_images,
                "num_keyframes": len(result.keyframes),
                "warnings": said,
            },
            "findings": findings,
            "keyframes": [record.asdict() for record in result.keyframes],
            "error": error,
            **({} if tracking is None else {"tracking": tracking}),
            "wall_time": {
                "solve": result.solve_time,
                "total": wall_time,
            },
            "environment": environment_data(waiting),
            "output": None if written is None else {"path": written, "format": "tum"},
        },
    )


def _headline(result: OdometryResult, error: TrajectoryError | None) -> list[str]:
    """Return the outcome with images and speed, and the error against the truth."""
    if not result.is_usable:
        return [f"Not usable: {result.message}. The trajectory ends there or is wrong."]
    end = "Interrupted: the trajectory ends early; " if result.interrupted else ""
    stamps = result.trajectory.timestamps_ns
    motion = 1e-9 * float(stamps[-1] - stamps[0])
    speed = f"{number(motion / max(result.solve_time, 1e-9))} times faster than real time"
    images = plural(result.num_images, "image", grouped=True)
    said = [
        f"{end}{images} over {number(motion)} s solved in {number(result.solve_time)} s ({speed}), "
        f"{plural(len(result.keyframes), 'keyframe')}."
    ]
    if error is not None:
        said.append(
            f"Position error {number(error.ate)} m rms (ATE) along {number(error.path_length)} m, "
            f"rotation {number(error.rotation_rms)} degrees, scale {error.scale:.4f}."
        )
    return said


def odometry_facts(
    source: str, result: OdometryResult, error: TrajectoryError | None
) -> list[tuple[str, str]]:
    """Return start, keyframes, time, and the errors if there is a truth."""
    stamps = result.trajectory.timestamps_ns
    seconds = 1e-9 * float(stamps[-1] - stamps[0])
    records = result.keyframes
    reasons = Counter(record.reason for record in records)
    chi2 = [r.mean_visual_chi2 for r in records if r.mean_visual_chi2 is not None]
    rows = [
        ("sequence", f"{shown(source)}, {number(seconds)} s"),
        ("start", result.start),
        ("images", f"{result.num_images} solved for"),
        (
            "keyframes",
            f"{len(records)}: " + ", ".join(f"{name} {count}" for name, count in reasons.items()),
        ),
        (
            "time",
            f"{number(result.solve_time)} s, "
            f"{number(seconds / max(result.solve_time, 1e-9))} times faster than real time",
        ),
        ("visual cost", f"{number(float(np.mean(chi2)) if chi2 else 0.0)} per residual (mean)"),
    ]
    if error is not None:
        rows += [
            (
                "position",
                f"{number(error.ate)} m rms (ATE) along {number(error.path_length)} m; aligned in "
                f"yaw and position only {number(error.ate_yaw)} m",
            ),
            ("scale", f"{error.scale:.5f}"),
            ("rotation", f"{number(error.rotation_rms)} degrees rms"),
        ]
    return rows


def _times(result: OdometryResult) -> Table:
    phases = ("preintegration", "assembly", "solve", "marginalization", "total")
    cells = []
    for phase in phases:
        times = 1e3 * np.array([record.times.get(phase, 0.0) for record in result.keyframes])
        values = (np.median(times), np.percentile(times, 95), times.max())
        cells.append((phase, *(number(float(value)) for value in values)))
    return Table.of(("ms per keyframe", "median", "p95", "max"), cells)


def _certainty(records: tuple[KeyframeRecord, ...]) -> list[tuple[str, str]]:
    """Return rows computed on request: nullity, sigma of yaw."""
    rows = []
    counted = Counter(r.nullity for r in records if r.nullity is not None)
    if counted:
        found = ", ".join(
            f"{value} at {plural(count, 'keyframe')}" for value, count in sorted(counted.items())
        )
        rows.append(("nullity", f"{found}; expected {records[-1].expected_nullity}"))
    if any(r.gyro_bias_sigma is not None for r in records):
        known = [r for r in records if r.yaw_sigma is not None]
        said = "unknown without --start-yaw-sigma"
        if known:
            first, last = (np.degrees(r.yaw_sigma or 0.0) for r in (known[0], known[-1]))
            turned = np.degrees(known[-1].accumulated_rotation)
            said = (
                f"{number(float(first))} degrees at first, {number(float(last))} at last, "
                f"after {number(float(turned))} degrees of rotation"
            )
        rows.append(("sigma of yaw", said))
    return rows


def _warnings(result: OdometryResult, findings: tuple[SequenceFinding | Finding, ...]) -> list[str]:
    """Return findings about the sequence, then one sentence per kind of alarm.

    The numbers in a sentence are those of the latest alarm of its kind.
    """
    total = plural(len(result.keyframes), "keyframe")
    return [f"{finding.sentence}." for finding in findings] + [
        f"{last[0].upper()}{last[1:]} (in {len(raised)} of {total})."
        for raised in alarms_by_kind(result.keyframes).values()
        for _, last in raised[-1:]
    ]


def telemetry_lines(result: OdometryResult) -> str:
    """Return one line of JSON per keyframe."""
    return "".join(
        json.dumps(plain(record.asdict()), allow_nan=False) + "\n" for record in result.keyframes
    )


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
