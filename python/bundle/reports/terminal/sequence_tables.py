"""What commands say of visual-inertial sequences."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from rich.console import RenderableType

from bundle._core import __version__
from bundle.base.tables import columns, facts, notes, number, plural
from bundle.errors import shown
from bundle.inertial.vio.sequence_statistics import SequenceStatistics
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import SequenceFinding
from bundle.reports.terminal.json import SCHEMA, plain

__all__ = [
    "contents_of_sequence",
    "conversion_of_sequence",
    "converted_sequence",
    "described_sequence",
    "heading_of_sequence",
    "information_of_sequence",
    "made_flight",
]


def contents_of_sequence(sequence: Sequence) -> str:
    """Return "6001 IMU samples, 601 images, 307 tracks, 13316 observations"."""
    return ", ".join(
        (
            plural(len(sequence.gyro), "IMU sample"),
            plural(sequence.num_frames, "image"),
            plural(len(np.unique(sequence.track_ids)), "track"),
            plural(len(sequence.xy), "observation"),
        )
    )


def described_sequence(
    path: str,
    sequence: Sequence,
    statistics: SequenceStatistics,
    findings: Iterable[SequenceFinding],
) -> list[RenderableType]:
    """Return what `bundle info` prints."""
    camera = sequence.calibration.camera_model or "normalised image coordinates"
    rest = statistics.static_start
    rows = [
        ("input", f"{shown(path)} (visual-inertial sequence)"),
        ("", contents_of_sequence(sequence)),
        ("camera", camera),
        ("duration", f"{sequence.duration:.3f} s of IMU, {statistics.overlap:.3f} s with images"),
        ("rates", f"{statistics.imu_rate:.4g} Hz IMU, {statistics.camera_rate:.4g} Hz images"),
        ("gaps", f"{plural(statistics.num_imu_gaps, 'gap')} of the IMU, "
                 f"{plural(statistics.num_image_gaps, 'gap')} of the images"),
        ("start", f"at rest for {rest:.2f} s" if rest else "moving"),
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
    wrong = [finding.sentence for finding in findings]
    return [
        facts(rows),
        "",
        columns(("", "min", "median", "mean", "max"), spread),
        "",
        columns(("noise density, per sqrt(Hz)", "at rest", "calibration"), sensors),
        "",
        facts([("looks wrong", "" if wrong else "nothing found")]),
        *notes(wrong, style="yellow"),
    ]


def information_of_sequence(
    path: str,
    format: str,
    sequence: Sequence,
    statistics: SequenceStatistics,
    findings: Iterable[SequenceFinding],
) -> dict[str, Any]:
    """Return the same for programs."""
    calibration = dataclasses.asdict(sequence.calibration)
    return {
        **heading_of_sequence("info", path, format, sequence),
        "calibration": plain(calibration),
        "statistics": plain(dataclasses.asdict(statistics)),
        "findings": plain([dataclasses.asdict(finding) for finding in findings]),
    }


def converted_sequence(path: str, sequence: Sequence, output: str) -> list[RenderableType]:
    """Return what `bundle convert` prints."""
    rows = [
        ("input", shown(path)),
        ("", contents_of_sequence(sequence)),
        ("output", f"{shown(output)} (visual-inertial sequence)"),
        ("lost", "nothing"),
    ]
    return [facts(rows)]


def made_flight(path: str, sequence: Sequence) -> list[RenderableType]:
    """Return what `bundle synth --scene flight` prints."""
    rows = [
        ("output", f"{shown(path)} (visual-inertial sequence)"),
        ("", contents_of_sequence(sequence)),
        ("ground truth", "ground_truth.csv in it, at the stamps of the images"),
    ]
    return [facts(rows)]


def conversion_of_sequence(
    path: str, format: str, sequence: Sequence, output: str
) -> dict[str, Any]:
    """Return the same for programs."""
    return {
        **heading_of_sequence("convert", path, format, sequence),
        "output": {"path": output, "format": "sequence"},
        "lost": [],
    }


def heading_of_sequence(command: str, path: str, format: str, sequence: Sequence) -> dict[str, Any]:
    """Return what every report on a sequence begins with."""
    return {
        "schema": SCHEMA,
        "command": command,
        "version": __version__,
        "input": {
            "path": path,
            "format": format,
            "num_imu_samples": len(sequence.gyro),
            "num_images": sequence.num_frames,
            "num_tracks": len(np.unique(sequence.track_ids)),
            "num_observations": len(sequence.xy),
        },
    }
