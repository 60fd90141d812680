"""Axes, units and clocks of a sequence: its tracks against its samples, as for images.

Before an odometry, a few pairs of images show if the gyroscope explains the rotation of the tracks;
only if it does not, the cause is searched. One or two linear starts show the sign of the forces.
After an odometry that failed or had alarms, all tests search its cause.
"""

from __future__ import annotations

import numpy as np

from bundle.errors import shown
from bundle.inertial.tracking.force_check import Signs, right_signs
from bundle.inertial.tracking.rotation_check import check_rotations, share_unexplained
from bundle.inertial.tracking.stamp_jitter import jitter_findings
from bundle.inertial.tracking.track_turns import turns_of_tracks
from bundle.inertial.tracking.tracking_findings import tracking_findings
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.interface.finding import Finding
from bundle.model.sequence.sequence import Recording, Sequence
from bundle.model.sequence.sequence_findings import bad_stretches, is_bridged, sequence_findings

FEW, MANY = 40, 200  # pairs of images
SUSPICIOUS = 0.3  # share of the rotation that the gyroscope does not explain; 0.2 if clean
REVERSED = "accelerometer axes"


def axes_findings(sequence: Sequence, path: str) -> tuple[Finding, ...]:
    """Return wrong units and axes, which spoil an odometry, or jitter of stamps; mostly empty."""
    if not _measures(sequence):
        return ()
    images = SequenceImages(sequence)
    recording = _recording(sequence, path)
    if share_unexplained(recording, turns_of_tracks(images, FEW)) > SUSPICIOUS:
        check = check_rotations(recording, turns_of_tracks(images, MANY))
        found = tracking_findings(recording, check)
        certain = tuple(each for each in found if each.is_problem and each.kind != "rotation")
        if certain:
            return certain
    signs = right_signs(images, is_gross=True)
    if signs is not None:
        return (_reversed(recording, signs, is_problem=True),)
    return jitter_findings(images, recording)


def explanations(sequence: Sequence, path: str) -> tuple[Finding, ...]:
    """Return what may explain a failed odometry or its alarms; it takes a second or two."""
    if not _measures(sequence):
        return ()
    images = SequenceImages(sequence)
    recording = _recording(sequence, path)
    check = check_rotations(recording, turns_of_tracks(images, MANY))
    found = tracking_findings(recording, check)
    signs = None if found or _is_noisier(sequence) else right_signs(images)
    return found if signs is None else (_reversed(recording, signs, is_problem=False),)


def _reversed(recording: Recording, signs: Signs, is_problem: bool) -> Finding:
    axes = " ".join("-+"[sign > 0] + name for sign, name in zip(signs, "xyz", strict=True))
    sentence = (
        f"{recording.imu_place(0)}: accel: expected forces that agree with the tracks, found that "
        f"axes {axes} in place of +x +y +z do: the accelerometer"
        + ("" if signs == (-1, -1, -1) else ", or an axis of it,")
        + " is reversed"
    )
    return Finding(kind=REVERSED, sentence=sentence, is_problem=is_problem)


def _measures(sequence: Sequence) -> bool:
    """Return False if a sensor stops for longer than can be bridged, which explains all else."""
    stretches = bad_stretches(sequence.gyro, sequence.accel)
    return all(is_bridged(each, sequence.imu_timestamps_ns) for each in stretches)


def _is_noisier(sequence: Sequence) -> bool:
    """Return True for more noise than stated, with which the errors of tracks decide nothing."""
    return any(each.kind == "noise" for each in sequence_findings(sequence, str, str))


def _recording(sequence: Sequence, path: str) -> Recording:
    stamps = np.unique(sequence.track_timestamps_ns)
    return Recording(
        name=shown(path),
        imu_timestamps_ns=sequence.imu_timestamps_ns,
        gyro=sequence.gyro,
        accel=sequence.accel,
        image_timestamps_ns=stamps,
        images=lambda *_: iter(()),
        calibration=sequence.calibration,
        notes=(),
        imu_place=lambda _: f"{shown(path)}: IMU",
        image_place=lambda _: shown(path),
    )
