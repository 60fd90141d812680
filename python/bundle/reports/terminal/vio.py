"""What `bundle vio` says."""

from __future__ import annotations

import json as standard_json
from collections import Counter
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import RenderableType

from bundle.base.tables import columns, facts, notes, plural
from bundle.base.words import number
from bundle.errors import shown
from bundle.inertial.vio.keyframe_record import KeyframeRecord, alarms_by_kind
from bundle.inertial.vio.odometry import OdometryResult
from bundle.inertial.vio.trajectory_comparison import TrajectoryError
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import SequenceFinding
from bundle.reports.terminal import json
from bundle.reports.terminal.sequence_tables import heading_of_sequence

__all__ = ["as_json", "odometry_tables", "telemetry_lines"]


def odometry_tables(
    source: str,
    result: OdometryResult,
    error: TrajectoryError | None,
    written: str | None,
    findings: tuple[SequenceFinding, ...] = (),
) -> list[RenderableType]:
    """Return start, keyframes, times, alarms, and errors where there is a truth.

    What looks wrong in the sequence itself is said before what the window made of it.
    """
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
    rows += _certainty(records)
    if error is not None:
        rows += [
            (
                "position",
                f"{number(error.ate)} m rms (ATE) along {number(error.path_length)} m; aligned in "
                f"yaw and position alone {number(error.ate_yaw)} m",
            ),
            ("scale", f"{error.scale:.5f}"),
            ("rotation", f"{number(error.rotation_rms)} degrees rms"),
        ]
    if written is not None:
        rows.append(("output", f"{shown(written)} (TUM)"))
    phases = ("preintegration", "assembly", "solve", "marginalization", "total")
    parts = {
        phase: 1e3 * np.array([record.times.get(phase, 0.0) for record in records])
        for phase in phases
    }
    table = columns(
        ("ms per keyframe", "median", "p95", "max"),
        [
            (phase, *(number(float(f(parts[phase]))) for f in (np.median, _p95, np.max)))
            for phase in phases
        ],
    )
    said = _warnings(result, findings)
    if result.interrupted:
        said.insert(0, "Interrupted: the trajectory goes as far as it came.")
    if not result.is_usable:
        said.insert(0, f"No trajectory was written: {result.message}.")
    return [facts(rows), "", table, *([""] if said else []), *notes(said)]


def _certainty(records: tuple[KeyframeRecord, ...]) -> list[tuple[str, str]]:
    """Return rows of what was computed on request: nullity, sigma of yaw."""
    rows = []
    counted = Counter(r.nullity for r in records if r.nullity is not None)
    if counted:
        found = ", ".join(
            f"{value} at {plural(count, 'keyframe')}" for value, count in sorted(counted.items())
        )
        rows.append(("nullity", f"{found}; expected {records[-1].expected_nullity}"))
    if any(r.gyro_bias_sigma is not None for r in records):
        known = [r for r in records if r.yaw_sigma is not None]
        said = "not known: needs --start-yaw-sigma"
        if known:
            first, last = (np.degrees(r.yaw_sigma or 0.0) for r in (known[0], known[-1]))
            turned = np.degrees(known[-1].accumulated_rotation)
            said = (
                f"{number(float(first))} degrees at first, {number(float(last))} at last, "
                f"after turns of {number(float(turned))} degrees in all"
            )
        rows.append(("sigma of yaw", said))
    return rows


def _warnings(result: OdometryResult, findings: tuple[SequenceFinding, ...]) -> list[str]:
    """Return what looks wrong in the sequence, then a sentence per kind of alarm.

    An alarm has the numbers of the last one of its kind.
    """
    total = plural(len(result.keyframes), "keyframe")
    return [f"{finding.sentence}." for finding in findings] + [
        f"{last[0].upper()}{last[1:]} (in {len(raised)} of {total})."
        for raised in alarms_by_kind(result.keyframes).values()
        for _, last in raised[-1:]
    ]


def _p95(values: Any) -> float:
    return float(np.percentile(values, 95))


def as_json(
    source: str,
    format: str,
    sequence: Sequence,
    result: OdometryResult,
    error: TrajectoryError | None,
    written: str | None,
    wall: float,
    findings: tuple[SequenceFinding, ...] = (),
) -> dict[str, Any]:
    """Return the report of `bundle vio`."""
    heading = heading_of_sequence("vio", source, format, sequence)
    heading["input"]["duration"] = sequence.duration
    report: dict[str, Any] = json.plain(
        {
            **heading,
            "options": result.options.asdict(),
            "summary": {
                "start": result.start,
                "is_solution_usable": result.is_usable,
                "interrupted": result.interrupted,
                "message": result.message,
                "num_images": result.num_images,
                "num_keyframes": len(result.keyframes),
                "warnings": _warnings(result, findings),
            },
            "findings": [asdict(finding) for finding in findings],
            "keyframes": [record.asdict() for record in result.keyframes],
            "error": None if error is None else asdict(error),
            "wall_time": {"solve": result.solve_time, "total": wall},
            "output": None if written is None else {"path": written, "format": "tum"},
        }
    )
    return report


def telemetry_lines(result: OdometryResult) -> str:
    """Return a line of JSON per keyframe."""
    return "".join(
        standard_json.dumps(json.plain(record.asdict()), allow_nan=False) + "\n"
        for record in result.keyframes
    )
