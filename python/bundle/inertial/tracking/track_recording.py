"""Sequences from images: reading, tracks through all images, and findings."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.inertial.tracking.feature_tracker import FeatureTracker
from bundle.inertial.tracking.relative_rotation import turn_of_samples
from bundle.inertial.tracking.rotation_check import RotationCheck
from bundle.inertial.tracking.sequence_axes import check_tracks, recording_findings
from bundle.inertial.vio.sequence_images import ImuSlices, SequenceImages
from bundle.interface.finding import Finding
from bundle.interface.window_options import TrackingOptions
from bundle.io.sequences.recordings import RecordingSource, read_recording
from bundle.model.sequence.sequence import Recording, Sequence, check_recording
from bundle.model.sequence.sequence_findings import SequenceFinding, sequence_findings

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Tracking:
    """Statistics of tracking.

    Attributes:
        num_images: number of images.
        num_outside: number of other images, before the first IMU sample or after the last.
        num_tracks: number of tracks with two or more images.
        mean_track_length: images per such track.
        tracks_per_image: mean number of them per image.
        share_lost: share of track steps to the next image that each check ended.
        share_predicted: share of images whose motion the gyroscope predicted.
        time_offset: seconds that were added to the stamps of images.
        time: seconds of reading and tracking.
        check: comparison of the rotations by tracks and gyroscope.
        notes: sources of the calibration.
    """

    num_images: int
    num_outside: int
    num_tracks: int
    mean_track_length: float
    tracks_per_image: float
    share_lost: dict[str, float]
    share_predicted: float
    time_offset: float
    time: float
    check: RotationCheck
    notes: tuple[str, ...]


def track_recording(
    recording: Recording, options: TrackingOptions, progress: Callable[[float], None] | None = None
) -> tuple[Sequence, Tracking]:
    """Track features through the images between the IMU samples.

    Raises:
        InputError: the recording fails a check, an image cannot be read, or tracks are missing.
        OSError: an image cannot be read.
    """
    began = time.perf_counter()
    check_recording(recording)
    calibration = recording.calibration
    first, last = recording.covered()
    times, samples = recording.image_times_ns, recording.imu_timestamps_ns
    if last - first < 2:
        covered, filmed = (1e-9 * float(each[-1] - each[0]) for each in (samples, times))
        raise InputError(
            f"{recording.name}: expected images between the first and the last IMU sample, found "
            f"{last - first} of {len(times)}: the samples cover {covered:.3g} s, the images "
            f"{filmed:.3g} s"
        )
    slices = ImuSlices(
        recording.imu_timestamps_ns, recording.gyro, recording.accel, "zero_order_hold"
    )
    tracker: FeatureTracker | None = None
    ids: list[Array] = []
    pixels: list[Array] = []
    for number, image in enumerate(recording.images(first, last), first):
        if tracker is None:
            tracker = FeatureTracker(calibration, (image.shape[1], image.shape[0]), options)
        turn = np.eye(3)
        if ids:
            interval = slices.between(int(times[number - 1]), int(times[number]))
            turn = turn_of_samples(interval, calibration)
        found = tracker.add(image, turn)
        ids.append(found[0])
        pixels.append(found[1])
        if progress is not None:
            progress((number + 1 - first) / (last - first))
    stamps = recording.image_timestamps_ns[first : first + len(ids)]
    image_of = np.repeat(np.arange(len(ids)), [len(each) for each in ids])
    track, xy = np.concatenate(ids), np.concatenate(pixels)
    _, row, count = np.unique(track, return_inverse=True, return_counts=True)
    long = count[row] > 1
    if not long.any() or tracker is None:
        raise InputError(
            f"{recording.name}: expected features in several images, found none: images without "
            "texture, or of different scenes?"
        )
    sequence = Sequence(
        imu_timestamps_ns=recording.imu_timestamps_ns,
        gyro=recording.gyro,
        accel=recording.accel,
        track_timestamps_ns=stamps[image_of[long]],
        track_ids=track[long],
        xy=xy[long],
        calibration=calibration,
    )
    kept = count[count > 1]
    steps = max(1, tracker.num_steps)
    return sequence, Tracking(
        num_images=len(ids),
        num_outside=len(times) - (last - first),
        num_tracks=len(kept),
        mean_track_length=float(kept.mean()),
        tracks_per_image=float(kept.sum()) / len(ids),
        share_lost={name: lost / steps for name, lost in tracker.lost.items()},
        share_predicted=tracker.num_predicted / max(1, len(ids) - 1),
        time_offset=calibration.time_offset,
        time=time.perf_counter() - began,
        check=check_tracks(SequenceImages(sequence), recording),
        notes=recording.notes,
    )


class TrackedImages(NamedTuple):
    """Sequence with the tracks of its images, statistics of tracking, and findings."""

    sequence: Sequence
    tracking: Tracking
    findings: tuple[SequenceFinding | Finding, ...]


def track_images(
    path: str | os.PathLike[str],
    *,
    calibration: Iterable[str | os.PathLike[str]] = (),
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
    source = RecordingSource(tuple(calibration), camera, imu, frame_times, image_topic, imu_topic)
    recording = read_recording(path, source)
    sequence, tracking = track_recording(recording, options or TrackingOptions(), progress)
    stamps, images = recording.image_timestamps_ns, SequenceImages(sequence)

    def place(row: int) -> str:
        return recording.image_place(int(stamps.searchsorted(sequence.track_timestamps_ns[row])))

    found: tuple[SequenceFinding | Finding, ...] = (
        *recording_findings(images, recording, tracking.check),
        *sequence_findings(sequence, recording.imu_place, place),
    )
    return TrackedImages(sequence, tracking, found)
