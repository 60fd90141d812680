"""Sequences from images: reading, tracking, and findings."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import NamedTuple

from bundle.inertial.tracking.rotation_check import tracking_findings
from bundle.inertial.tracking.stamp_jitter import jitter_findings
from bundle.inertial.tracking.track_recording import Tracking, track_recording
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.interface.finding import Finding
from bundle.interface.window_options import TrackingOptions
from bundle.io.sequences.recordings import RecordingSource, read_recording
from bundle.model.sequence.sequence import Sequence as Tracks
from bundle.model.sequence.sequence_findings import SequenceFinding, sequence_findings


class TrackedImages(NamedTuple):
    """Sequence with the tracks of its images, statistics of tracking, and findings."""

    sequence: Tracks
    tracking: Tracking
    findings: tuple[SequenceFinding | Finding, ...]


def track_images(
    path: str | os.PathLike[str],
    *,
    calibration: Sequence[str | os.PathLike[str]] = (),
    camera: str = "cam0",
    imu: str | os.PathLike[str] | None = None,
    frame_times: str | os.PathLike[str] | None = None,
    image_topic: str | None = None,
    imu_topic: str | None = None,
    options: TrackingOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> TrackedImages:
    """Track features through the images of a recording, such as EuRoC's ``mav0``.

    One image is in memory at a time. The result is the same in every run.

    Args:
        path: ``mav0`` or its parent, a ROS bag, or a video.
        calibration: files in place of those of the recording: ``calibration.yaml``, or Kalibr's
            ``camchain-imucam.yaml`` and ``imu.yaml``.
        camera: name of the camera: a folder of mav0, and an entry of a camchain.
        imu: table of the IMU's samples, for a video: stamps in nanoseconds or, with a decimal
            point, in seconds; rad/s; m/s^2.
        frame_times: times of the frames of a video, one a line; None: a constant rate from 0.
        image_topic: topic of a bag; None: the rostopic of the calibration, or the only one.
        imu_topic: likewise.
        options: options of tracking.
        progress: called after each image with the share that is done; None: not called.

    Raises:
        InputError: a file violates its format, an image is missing or truncated, stamps or units
            are wrong, or OpenCV is not installed.
        OSError: a file cannot be read.
    """
    files = tuple(calibration)
    source = RecordingSource(files, camera, imu, frame_times, image_topic, imu_topic)
    recording = read_recording(path, source)
    sequence, tracking = track_recording(recording, options or TrackingOptions(), progress)
    stamps = recording.image_timestamps_ns

    def place(row: int) -> str:
        return recording.image_place(int(stamps.searchsorted(sequence.track_timestamps_ns[row])))

    found: tuple[SequenceFinding | Finding, ...] = (
        *tracking_findings(recording, tracking.check),
        *jitter_findings(SequenceImages(sequence), recording),
        *sequence_findings(sequence, recording.imu_place, place),
    )
    return TrackedImages(sequence, tracking, found)
