"""Reports on visual-inertial sequences: `bundle info`, `convert`, `vio` and its two loops."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence as Many
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.base.own_process import Waiting
from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.inertial.vio.keyframe_record import KeyframeRecord, alarms_by_kind
from bundle.inertial.vio.window_alarms import NO_EXCITATION
from bundle.interface.finding import Finding
from bundle.model.content_digests import content_digests
from bundle.model.sequence.sequence import Sequence
from bundle.reports.sections import Report, Section, Table, plain
from bundle.reports.terminal.solve_data import environment_data

if TYPE_CHECKING:
    from bundle.inertial.tracking.track_recording import Tracking
    from bundle.inertial.two_loops.replay import TwoLoopsResult
    from bundle.inertial.vio.odometry import OdometryResult, SequenceStatistics
    from bundle.inertial.vio.trajectory_comparison import TrajectoryError
    from bundle.interface.scene_options import FlightOptions
    from bundle.model.sequence.sequence_findings import SequenceFinding


def contents_of_sequence(sequence: Sequence) -> str:
    """Return text such as "6001 IMU samples, 601 images, 307 tracks, 13316 observations"."""
    nouns = ("IMU sample", "image", "track", "observation")
    return ", ".join(map(plural, _counts(sequence), nouns))


def about_sequence(path: str, format: str, sequence: Sequence) -> dict[str, Any]:
    """Return path, format and counts of a sequence as JSON entries."""
    names = ("num_imu_samples", "num_images", "num_tracks", "num_observations")
    return {"path": path, "format": format, **dict(zip(names, _counts(sequence), strict=True))}


def _counts(sequence: Sequence) -> tuple[int, int, int, int]:
    tracks = len(np.unique(sequence.track_ids))
    return len(sequence.gyro), sequence.num_frames, tracks, len(sequence.xy)


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
    """Return the report; ``findings`` are about the sequence, ``written`` the trajectory's path."""
    said = _warnings(result, findings)
    return Report(
        command="vio",
        input={
            **about_sequence(source, format, sequence),
            "duration": sequence.duration,
            "digests": content_digests(sequence),
        },
        headline=[
            *odometry_headline(result, error),
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
            "wall_time": {"solve": result.solve_time, "total": wall_time},
            "environment": environment_data(waiting),
            "output": None if written is None else {"path": written, "format": "tum"},
        },
    )


def odometry_headline(result: OdometryResult, error: TrajectoryError | None) -> list[str]:
    """Return whether the odometry is usable, its errors, pace and uncertain scale."""
    if not result.is_usable:
        return [f"Not usable: {result.message}. The trajectory ends there or is wrong."]
    end = "Interrupted: the trajectory ends early; " if result.interrupted else ""
    images = plural(result.num_images, "image", grouped=True)
    said = [
        f"{end}{images} over {number(result.duration)} s solved in {number(result.solve_time)} s "
        f"({_pace(result)}), {plural(len(result.keyframes), 'keyframe')}."
    ]
    uncertain = [
        record.speed_sigma
        for record in result.keyframes
        if NO_EXCITATION in record.alarms and record.speed_sigma is not None
    ]
    if uncertain:
        said.append(
            f"Without excitation, the scale has a standard deviation of up to "
            f"{100 * max(uncertain):.2g} %."
        )
    if error is not None:
        said.insert(
            bool(end),
            f"Position error {number(error.ate)} m rms (ATE) along {number(error.path_length)} m, "
            f"rotation {number(error.rotation_rms)} degrees, scale {error.scale:.4f}.",
        )
    return said


def _pace(result: OdometryResult) -> str:
    ratio = max(result.duration, 1e-9) / max(result.solve_time, 1e-9)
    kind = "faster" if ratio >= 1 else "slower"
    return f"{number(max(ratio, 1 / ratio))} times {kind} than real time"


def odometry_facts(
    source: str, result: OdometryResult, error: TrajectoryError | None
) -> list[tuple[str, str]]:
    """Return start, keyframes, time, and the errors if there is a truth."""
    records = result.keyframes
    reasons = Counter(record.reason for record in records)
    chi2 = [r.mean_visual_chi2 for r in records if r.mean_visual_chi2 is not None]
    rows = [
        ("sequence", f"{shown(source)}, {number(result.duration)} s"),
        ("start", result.start),
        ("images", f"{result.num_images} solved for"),
        (
            "keyframes",
            f"{len(records)}: " + ", ".join(f"{name} {count}" for name, count in reasons.items()),
        ),
        ("time", f"{number(result.solve_time)} s, {_pace(result)}"),
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
    """Return the report of an odometry, extended by that of its two loops and their poses."""
    found = result.statistics
    late = "" if found.lateness is None else f", {found.num_late:,} late by more than 5 ms"
    accuracy = "" if error is None else f"; error {number(error.ate)} m rms (ATE)"
    closures = plural(found.num_closures, "closure")
    return replace(
        report,
        headline=[
            *report.headline,
            f"Published {found.num_poses:,} poses with {closures}{late}{accuracy}.",
        ],
        sections=[*report.sections, _section(result, error)],
        data={**report.data, "two_loops": _data(result, error, written)},
    )


def _section(result: TwoLoopsResult, error: TrajectoryError | None) -> Section:
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
    """Return the entry ``two_loops`` of the JSON report."""
    motion = result.correction
    return {
        **result.statistics.asdict(),
        "correction": {"yaw": motion.yaw, "translation": motion.shift},
        "error": error,
        "output": None if written is None else {"path": written, "format": "tum"},
    }


def tracking_headline(tracking: Tracking) -> str:
    """Return the number of tracks, their length, and the share that the checks ended."""
    lost = 100 * sum(tracking.share_lost.values())
    return (
        f"{plural(tracking.num_tracks, 'track', grouped=True)} of "
        f"{number(tracking.mean_track_length)} images on average, "
        f"{tracking.tracks_per_image:.0f} per image, tracked in {number(tracking.time)} s; checks "
        f"ended {lost:.1f} % per image. "
        f"{_offset(tracking)}"
    )


def tracking_section(sequence: Sequence, tracking: Tracking) -> Section:
    """Return facts: units, axes, time offset, tracks and checks."""
    calibration, check = sequence.calibration, tracking.check
    outside = (
        f", {tracking.num_outside} others outside the IMU samples" if tracking.num_outside else ""
    )
    lost = ", ".join(f"{100 * share:.1f} % {name}" for name, share in tracking.share_lost.items())
    agreement = "not compared: the camera hardly turns"
    if check.num_pairs:
        agreement = (
            f"rotations of tracks and gyroscope differ by {100 * check.unexplained:.1f} % (median "
            f"of {check.num_pairs} image pairs)"
        )
        if math.isfinite(check.angle_sigma):
            agreement += (
                f"; the rotation of camera_from_imu differs by {number(check.angle)} degrees from "
                "that of the tracks"
            )
    noise = calibration.noise
    return Section(
        facts=[
            ("camera", f"{calibration.camera_model}, {calibration.camera_rate:g} Hz, pixels from "
                       "the centre of the first one"),
            ("IMU", f"{calibration.imu_rate:g} Hz, rad/s and m/s^2; noise densities "
                    f"{noise.gyro_noise_density:g} rad/s/sqrt(Hz), "
                    f"{noise.accel_noise_density:g} m/s^2/sqrt(Hz)"),
            ("axes", agreement),
            ("time", _offset(tracking)),
            ("tracks", f"{plural(tracking.num_tracks, 'track')} in {tracking.num_images} images"
                       f"{outside}"),
            ("ended", f"per image: {lost}"),
            ("predicted", f"motion of {100 * tracking.share_predicted:.0f} % of the images, by the "
                          "gyroscope"),
        ],
        notes=tracking.notes,
        is_detail=True,
    )  # fmt: skip


def _offset(tracking: Tracking) -> str:
    used = f"{1e3 * tracking.time_offset:.4g} ms were added to the stamps of images"
    check = tracking.check
    if not math.isfinite(check.time_sigma):
        return f"{used}."
    implied = 1e3 * (tracking.time_offset + check.time_shift)
    return f"{used}; the tracks imply {implied:.1f} ms (sigma {1e3 * check.time_sigma:.1f})."


def described_sequence(
    path: str,
    format: str,
    sequence: Sequence,
    statistics: SequenceStatistics,
    findings: Many[SequenceFinding | Finding],
    tracking: Tracking | None = None,
) -> Report:
    """Return the report on a sequence; ``tracking``: None if the input has tracks."""
    camera = sequence.calibration.camera_model or "normalised image coordinates"
    rest = statistics.static_start
    start = f"at rest for {rest:.2f} s" if rest else "moving"
    wrong = [finding.sentence for finding in findings]
    headline = [
        f"{contents_of_sequence(sequence)} over {sequence.duration:.1f} s.",
        f"Starts {start}; excitation {number(statistics.excitation)} m/s^2: {statistics.verdict}.",
        *([] if tracking is None else [tracking_headline(tracking)]),
        *([] if wrong else ["Nothing looks wrong."]),
    ]
    rows = [
        ("input", f"{shown(path)} (visual-inertial sequence)"),
        ("", contents_of_sequence(sequence)),
        ("camera", camera),
        ("duration", f"{sequence.duration:.3f} s of IMU, {statistics.overlap:.3f} s with images"),
        ("rates", f"{statistics.imu_rate:.4g} Hz IMU, {statistics.camera_rate:.4g} Hz images"),
        ("gaps", f"{plural(statistics.num_imu_gaps, 'gap')} of the IMU, "
                 f"{plural(statistics.num_image_gaps, 'gap')} of the images"),
        ("start", start),
        ("excitation", f"{number(statistics.excitation)} m/s^2: {statistics.verdict}"),
    ]  # fmt: skip
    spread = [
        (label, *(number(values[key]) for key in ("min", "median", "mean", "max")))
        for label, values in (
            ("tracks per image", statistics.tracks_per_image),
            ("track length", statistics.track_length),
        )
    ]
    noise = sequence.calibration.noise
    sensors = [
        (
            "gyroscope [rad/s]",
            number(statistics.gyro_noise_density),
            number(noise.gyro_noise_density),
        ),
        (
            "accelerometer [m/s^2]",
            number(statistics.accel_noise_density),
            number(noise.accel_noise_density),
        ),
    ]
    tables = [
        Table.of(("", "min", "median", "mean", "max"), spread),
        Table.of(("noise density, per sqrt(Hz)", "at rest", "calibration"), sensors),
    ]
    return Report(
        command="info",
        input=about_sequence(path, format, sequence),
        headline=headline,
        warnings=wrong,
        sections=[
            Section(facts=rows, tables=tables, is_detail=True),
            *([] if tracking is None else [tracking_section(sequence, tracking)]),
        ],
        data={
            "calibration": sequence.calibration,
            "statistics": statistics,
            "findings": findings,
            **({} if tracking is None else {"tracking": tracking}),
        },
    )


def converted_sequence(
    path: str,
    format: str,
    sequence: Sequence,
    output: str,
    findings: Many[SequenceFinding | Finding] = (),
    tracking: Tracking | None = None,
) -> Report:
    """Return the report on a converted sequence; ``tracking``: None if the input has tracks."""
    wrote = f"Wrote {shown(output)} (visual-inertial sequence)"
    lost = [] if tracking is None else ["images"]
    rest = "Nothing is lost." if tracking is None else tracking_headline(tracking)
    return Report(
        command="convert",
        input=about_sequence(path, format, sequence),
        headline=[f"{wrote}: {contents_of_sequence(sequence)}. {rest}"],
        warnings=[] if tracking is None else [f"{finding.sentence}." for finding in findings],
        sections=[
            Section(facts=[("input", shown(path))], is_detail=True),
            *([] if tracking is None else [tracking_section(sequence, tracking)]),
        ],
        data={
            "output": {"path": output, "format": "sequence"},
            "lost": lost,
            **({} if tracking is None else {"tracking": tracking, "findings": findings}),
        },
    )


def made_flight(path: str, sequence: Sequence, options: FlightOptions) -> Report:
    """Return the report on a flight."""
    counts = about_sequence(path, "sequence", sequence)
    wrote = f"Wrote {shown(path)} (visual-inertial sequence)"
    return Report(
        command="synth",
        headline=[
            f"{wrote}: {contents_of_sequence(sequence)}.",
            "Its ground_truth.csv has the true poses at the stamps of the images.",
        ],
        data={
            "options": options.asdict(),
            "output": {"path": path, "format": "sequence"},
            "ground_truth": {"path": f"{path.rstrip('/')}/ground_truth.csv", "format": "euroc"},
            "contents": {
                key: value for key, value in counts.items() if key not in ("path", "format")
            },
        },
    )
