"""Facts about tracked images, and report of `bundle info` on a sequence."""

from __future__ import annotations

import math
from collections.abc import Sequence as Findings
from typing import TYPE_CHECKING

from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.interface.finding import Finding
from bundle.model.sequence.sequence import Sequence
from bundle.reports.sections import Report, Section, Table
from bundle.reports.terminal.inputs import about_sequence, contents_of_sequence

if TYPE_CHECKING:
    from bundle.inertial.tracking.track_recording import Tracking
    from bundle.inertial.vio.odometry import SequenceStatistics
    from bundle.model.sequence.sequence_findings import SequenceFinding


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
            agreement += f"; camera_from_imu is within {number(check.angle)} degrees"
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
