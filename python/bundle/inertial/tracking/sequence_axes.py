"""Axes, units and clocks of a sequence: its tracks against its samples.

Before an odometry, a few pairs of images show if the gyroscope explains the rotation of the tracks;
only if it does not, the cause is searched. Tracks of images, which took much longer to find, are
always compared in full. One or two linear starts show the sign of the forces. After an odometry
that failed or had alarms, all tests search its cause.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from bundle.errors import shown
from bundle.inertial.tracking.rates_and_stamps import bias_findings, jitter_findings, scale_findings
from bundle.inertial.tracking.relative_rotation import turns_of_tracks
from bundle.inertial.tracking.rotation_check import (
    RotationCheck,
    check_rotations,
    share_unexplained,
    tracking_findings,
)
from bundle.inertial.vio.initialize import SPAN, Span, find_span, objection_to, span_start
from bundle.inertial.vio.linear_start import ACCEL_BIAS_SIGMA
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.interface.finding import Finding
from bundle.model.sequence.sequence import Recording, Sequence
from bundle.model.sequence.sequence_findings import SequenceFinding, bad_stretches, is_short

FEW, MANY = 40, 200  # pairs of images
SUSPICIOUS = 0.3  # share of the rotation that the gyroscope does not explain; 0.2 if clean
REVERSED = "accelerometer axes"


def axes_findings(sequence: Sequence, path: str) -> tuple[Finding, ...]:
    """Return wrong units and axes, which spoil an odometry, or jitter of stamps; mostly empty."""
    if not _measures(sequence):
        return ()
    images, recording = SequenceImages(sequence), _recording(sequence, path)
    if share_unexplained(recording, turns_of_tracks(images, FEW)) > SUSPICIOUS:
        found = tracking_findings(recording, check_tracks(images, recording))
        certain = tuple(each for each in found if each.is_problem and each.kind != "rotation")
        if certain:
            return certain
    return _motion_findings(images, recording)


def recording_findings(
    images: SequenceImages, recording: Recording, check: RotationCheck
) -> tuple[Finding, ...]:
    """Return all findings on the axes, units and clocks of images that were tracked."""
    if not _measures(images.sequence):
        return ()
    found = tracking_findings(recording, check)
    if any(each.is_problem for each in found):
        return found
    return (*found, *_motion_findings(images, recording))


def check_tracks(images: SequenceImages, recording: Recording) -> RotationCheck:
    """Return the comparison of the rotations of tracks and gyroscope over the whole recording."""
    return check_rotations(recording, turns_of_tracks(images, MANY))


def _motion_findings(images: SequenceImages, recording: Recording) -> tuple[Finding, ...]:
    """Return a reversed accelerometer, a wrong scale of the gyroscope, or jitter of stamps."""
    signs = right_signs(images, is_gross=True)
    if signs is not None:
        return (_reversed(recording, signs, is_problem=True),)
    return scale_findings(images, recording) or jitter_findings(images, recording)


def explanations(
    sequence: Sequence, path: str, known: Iterable[Finding | SequenceFinding] = ()
) -> tuple[Finding, ...]:
    """Return further causes of a failed odometry or its alarms, in a second or two.

    If noise exceeds the stated one, or stamps are wrong, the errors of tracks prove nothing.
    """
    if not _measures(sequence):
        return ()
    images, recording = SequenceImages(sequence), _recording(sequence, path)
    if constant := _constant_axes(recording):
        return constant
    turns = turns_of_tracks(images, MANY)
    found = tracking_findings(recording, check_rotations(recording, turns))
    if all(each.kind == "time offset" for each in found):  # a jump looks like an offset
        found = bias_findings(recording, turns) or found
    kinds = {each.kind for each in known}
    if not found and not {"noise", "stamps"} & kinds:
        found = scale_findings(images, recording, with_rays=True)
        signs = None if found else right_signs(images)
        if signs is not None:
            found = (_reversed(recording, signs, is_problem=False),)
    return tuple(each for each in found if each.kind not in kinds)


def _reversed(recording: Recording, signs: Signs, is_problem: bool) -> Finding:
    axes = " ".join("-+"[sign > 0] + name for sign, name in zip(signs, "xyz", strict=True))
    sentence = (
        f"{recording.imu_place(0)}: accel: expected forces that agree with the tracks, found that "
        f"only axes {axes} in place of +x +y +z agree: the accelerometer"
        + ("" if signs == (-1, -1, -1) else ", or an axis of it,")
        + " is reversed"
    )
    return Finding(kind=REVERSED, sentence=sentence, is_problem=is_problem)


def _measures(sequence: Sequence) -> bool:
    """Return False if a sensor stops for longer than can be bridged: this explains everything."""
    stretches = bad_stretches(sequence.gyro, sequence.accel)
    return all(is_short(each, sequence.imu_timestamps_ns) for each in stretches)


def _constant_axes(recording: Recording) -> tuple[Finding, ...]:
    return tuple(
        Finding(
            kind="constant axis",
            sentence=f"{recording.imu_place(0)}: {name}: expected axes that vary, found "
            f"{values[0, k]:g} on {'xyz'[k]} in all samples",
        )
        for name, values in (("gyro", recording.gyro), ("accel", recording.accel))
        for k in np.flatnonzero(np.ptp(values, axis=0) == 0).tolist()
    )


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


# Signs of the accelerometer's axes, by the linear start of several spans.
#
# The linear start determines velocity, gravity and depths in metres from tracks and samples. It
# does not know that points are in front of the camera. If all forces have the wrong sign, or those
# along gravity, the same motion mirrored at the first image explains gravity and parallax:
# velocities and depths are negative, those of nearly all points in every span with an acceleration.
#
# If other axes are reversed, the start may pass all its tests: a gentle motion along one axis is
# small beside gravity. The tracks then decide among the eight signs. With e the errors of n
# observations in sigmas, m points, and a bias a with the prior deviation s,
#
#     L(signs) = C / v + |a|^2 / s^2,   C = sum log(1 + |e|^2),   v = least C / (2 n - 3 m - 11)
#
# is twice the negative log-likelihood. Under the right signs, a likelihood ratio has the
# expectation 1, so that one of seven others is better by 2 log(7 / p) with a probability of at most
# p (Markov). Two spans that prefer the same signs by this much name the axes, unless one before
# them prefers others or the given ones.

BEHIND = 0.95  # share of points behind the camera, from which forces along gravity are reversed
SPANS = 6
AGREE = 2  # spans that decide
NO_PARALLAX = "no parallax"
STANDARD_GRAVITY = 9.81
FALSE_ALARM = 1e-4  # in a span
CLEAR = 2 * math.log(7 / FALSE_ALARM)
GIVEN = (1, 1, 1)

Signs = tuple[int, ...]


class _Start(NamedTuple):
    """Linear start of a span."""

    objection: str  # the test that it fails
    behind: float  # share of points behind the camera
    misfit: float = 0.0  # C
    prior: float = 0.0  # |a|^2 / s^2
    freedom: int = 1  # 2 n - 3 m - 11


def right_signs(images: SequenceImages, is_gross: bool = False) -> Signs | None:
    """Return better signs of the accelerometer's axes; ``is_gross``: only if points are behind."""
    changed: dict[Signs, SequenceImages] = {}
    for each in product((1, -1), repeat=3):
        accel = images.sequence.accel * np.array(each, np.float64)
        changed[each] = SequenceImages(replace(images.sequence, accel=accel))
    found: list[Signs] = []
    for span in _spans(images):
        starts: dict[Signs, _Start] = {GIVEN: _start(changed[GIVEN], span)}
        objection, behind = starts[GIVEN][:2]
        if is_gross and not objection:
            return None
        if objection == NO_PARALLAX or (is_gross and behind < BEHIND):
            continue
        starts |= {signs: _start(changed[signs], span) for signs in changed if signs != GIVEN}
        best = _clear_signs(starts)
        if best is None:
            continue
        found.append(best)
        if best == GIVEN or best != found[0]:
            return None
        if len(found) == AGREE:
            return best
    return None


def _clear_signs(starts: dict[Signs, _Start]) -> Signs | None:
    """Return the signs that explain a span better than all others, if they pass its tests."""
    least = min(starts.values(), key=lambda start: start.misfit)
    variance = max(least.misfit / max(least.freedom, 1), 1e-12)
    costs = {signs: start.misfit / variance + start.prior for signs, start in starts.items()}
    best, second = sorted(costs, key=costs.__getitem__)[:2]
    is_clear = costs[second] - costs[best] > CLEAR and not starts[best].objection
    return best if is_clear else None


def _spans(images: SequenceImages) -> Iterator[Span]:
    """Yield spans spread over the sequence, the last one first: vehicles begin at rest."""
    stamps, covered = images.stamps, np.flatnonzero(images.covered)
    first, last = int(stamps[covered[0]]), int(stamps[covered[-1]] - 1e9 * SPAN)
    for stamp in np.linspace(last, first, SPANS).round() if last > first else ():
        span = find_span(images, int(np.searchsorted(stamps, stamp)), int(covered[-1]))
        if span is not None:
            yield span


def _start(images: SequenceImages, span: Span) -> _Start:
    calibration = images.sequence.calibration
    found = span_start(images, span, STANDARD_GRAVITY, "zero_order_hold")
    sigma = calibration.pixel_sigma / calibration.focal
    errors = np.sum(((found.predicted - span.seen.xy) / sigma) ** 2, axis=1)
    misfit = float(np.log1p(errors).sum())
    return _Start(
        objection=objection_to(found, span, calibration),
        behind=float(np.mean(found.depths <= 0)),
        misfit=misfit if math.isfinite(misfit) else math.inf,
        prior=float(found.accel_bias @ found.accel_bias) / ACCEL_BIAS_SIGMA**2,
        freedom=2 * len(errors) - 3 * len(span.track_ids) - 11,
    )
