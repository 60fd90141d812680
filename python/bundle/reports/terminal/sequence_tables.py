"""Report of `bundle info` on a visual-inertial sequence."""

from __future__ import annotations

from collections.abc import Sequence as Findings

from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.inertial.tracking.track_recording import Tracking
from bundle.inertial.vio.sequence_statistics import SequenceStatistics
from bundle.interface.finding import Finding
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import SequenceFinding
from bundle.reports.sections import Report, Section, Table
from bundle.reports.terminal.inputs import about_sequence, contents_of_sequence
from bundle.reports.terminal.tracking import tracking_headline, tracking_section


def described_sequence(
    path: str,
    format: str,
    sequence: Sequence,
    statistics: SequenceStatistics,
    findings: Findings[SequenceFinding | Finding],
    tracking: Tracking | None = None,
) -> Report:
    """Return the report.

    Args:
        path: path of the input.
        format: format of the input.
        sequence: the sequence.
        statistics: statistics of the sequence.
        findings: suspicious properties of the sequence.
        tracking: statistics of tracking; None if the sequence has tracks.
    """
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
