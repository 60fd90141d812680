"""Axes, units and clocks of a sequence: its tracks against its samples.

Before an odometry, a few pairs of images show whether the gyroscope agrees with the rotation of the
tracks; the cause is searched only if it does not. Tracks of images, which took much longer to find,
are always compared in full. One or two linear starts show the sign of the forces. After an odometry
that failed or had alarms, all tests search its cause.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from bundle.errors import shown
from bundle.inertial.tracking.relative_rotation import Turn, turns_of_tracks
from bundle.inertial.tracking.rotation_check import (
    SHIFTS,
    RotationCheck,
    RotationPairs,
    check_rotations,
    share_unexplained,
    tracking_findings,
)
from bundle.inertial.vio.initialize import SPAN, Span, find_span, objection_to, span_start
from bundle.inertial.vio.linear_start import ACCEL_BIAS_SIGMA
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.interface.finding import Finding
from bundle.model.rigid_motions import cross_matrices
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
    """Return False if a sensor stops for too long to be bridged: no other cause is searched."""
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
FALSE_ALARM = 1e-4
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


# Scale and bias of rates, jitter of stamps, by the rotations of tracks and gyroscope.
#
# **Scale of rates.** Let c be the rotation of the camera, g that of the IMU, R the rotation of
# camera_from_imu. Rates that are k times too large, a bias b, a small rotation a of the camera and
# a late clock by d leave, with the rates w at both images and T between them,
#
#     c - R g = s R g + a x R g + d R (w_j - w_i) - T R b,        k = 1 / (1 + s),
#
# by least squares with the information on c, Cauchy weights, and weak priors, without which s and b
# are not separable at constant speed. With the right k, only errors of tracks remain. If a larger
# residual remains, or s, a or d exceed their priors, another fault affects the rotations: k is
# unknown. Without more noise of the samples it is in rays or stamps: forces do not affect
# rotations.
#
# **Change of the bias.** (g - R^T c) / T is the bias b of each pair. The medians before and after a
# time differ by at most 5 deviations in clean flights, by 17 with a turned camera, and by 26 or
# more if b jumps by 0.05 rad/s or more.
#
# **Jitter of stamps.** A camera with a constant rate exposes image k at a + k b; stamps of receipt
# are late by different times. If the stamps deviate from the nearest such line, the rotations of
# the tracks between consecutive images decide between both. With e the errors of
# :mod:`rotation_check` in units of their robust deviation under the better of both,
#
#     T = sum log(1 + |e|^2, given stamps) - sum log(1 + |e|^2, stamps on the line)
#
# is twice a log-likelihood ratio. If the given stamps are right, the expectation of the ratio is 1,
# so that T exceeds 2 log(1 / p) with a probability of at most p (Markov). Consecutive images share
# one stamp only, so that the errors of pairs are nearly independent.

Array = np.ndarray[Any, Any]

LEAST = 1e-3  # s: rms of deviations below which nothing is compared
FEWEST, MOST = 30, 300  # pairs of images
CONSECUTIVE = 2 / 3  # of a period: least time between the images of a pair; most is twice this
SCALE_PAIRS, SCALE_APART = 60, 0.5  # pairs of images; s
SIGMAS, SCALE = 5.0, 0.02  # from which a scale is wrong; 0.0024 off in clean flights
PRIOR = np.repeat([1.0, 0.2, 0.03, 0.1], (1, 3, 1, 3))  # deviations of s, a, d and b
MOST_VARIANCE = 4.0  # of errors in units of tracks; up to 2.9 in clean flights, 8 with faults
CHANGE_FEWEST = 25  # pairs of images on each side of a change
CHANGE_SIGMAS, CHANGE = 20.0, 0.02  # from which the bias changes: deviations, rad/s
STEPS, MEDIAN_CHI2 = 20, 2.366  # of the weights; with three degrees of freedom


def scale_findings(
    images: SequenceImages, recording: Recording, with_rays: bool = False
) -> tuple[Finding, ...]:
    """Return a finding on the scale of rates; ``with_rays`` also on what no scale explains."""
    stretches = bad_stretches(recording.gyro, recording.accel)
    if any((each.kind, each.sensor) == ("saturated", "gyro") for each in stretches):
        return ()
    turns = turns_of_tracks(images, SCALE_PAIRS, SCALE_APART)
    pairs = RotationPairs(recording, turns, least_turn=0.0)
    if len(pairs.camera) < FEWEST:
        return ()
    ratio, sigma, variance = scale_of_rates(pairs, pairs.lens)
    if with_rays and variance > MOST_VARIANCE:
        sentence = (
            f"{recording.name}: rotations of tracks and gyroscope differ by {variance**0.5:.2g} "
            "times the errors of tracks, whatever scale, angle and time offset: the focal length, "
            "the lens, a rolling shutter, single stamps, a changing bias or a loose camera"
        )
        return (Finding(kind="rotation", sentence=sentence, evidence={"variance": variance}),)
    if not abs(ratio - 1) > max(SCALE, SIGMAS * sigma):  # nan: nothing follows
        return ()
    sentence = (
        f"{recording.imu_place(0)}: gyro: expected rates that agree with the tracks, found "
        f"{ratio:.3f} times these (sigma {sigma:.2g}): the scale of the gyroscope or the focal "
        "length is wrong"
    )
    evidence = {"ratio": ratio, "sigma": sigma, "num_pairs": len(pairs.camera)}
    return (Finding(kind="gyro scale", sentence=sentence, evidence=evidence, is_problem=True),)


def scale_of_rates(pairs: RotationPairs, lens: Array) -> tuple[float, float, float]:
    """Return k, its standard deviation (nan for both with another fault), the variance factor."""
    step = float(SHIFTS[1] - SHIFTS[0])
    turned = pairs.imu(0.0) @ lens.T
    change = (pairs.imu(step) - pairs.imu(-step)) @ lens.T / (2 * step)
    seconds = 1e-9 * np.diff(pairs.spans)[..., None]
    roots = np.linalg.cholesky(pairs.information).transpose(0, 2, 1)
    columns = [turned[..., None], -cross_matrices(turned), change[..., None], -seconds * lens]
    rows = roots @ np.concatenate(columns, axis=2)
    errors = (roots @ (pairs.camera - turned)[..., None])[..., 0]
    weights, variance = np.ones(len(errors)), 1.0
    for _ in range(STEPS):
        normal = np.einsum("n,nij,nik->jk", weights, rows, rows) / variance
        covariance = np.linalg.inv(normal + np.diag(PRIOR**-2))
        found = covariance @ np.einsum("n,nij,ni->j", weights, rows, errors) / variance
        squares = ((errors - rows @ found) ** 2).sum(axis=1)
        variance = max(float(np.median(squares)) / MEDIAN_CHI2, 1e-12)
        weights = 1 / (1 + squares / (3 * variance))
    if variance > MOST_VARIANCE or (np.abs(found) > PRIOR)[:5].any():
        return math.nan, math.nan, variance
    ratio = 1 / (1 + float(found[0]))
    return ratio, ratio**2 * math.sqrt(float(covariance[0, 0])), variance


def bias_findings(recording: Recording, turns: list[Turn]) -> tuple[Finding, ...]:
    """Return a finding if the bias of the gyroscope changes at a time."""
    pairs = RotationPairs(recording, turns, least_turn=0.0)
    if len(pairs.camera) < 2 * CHANGE_FEWEST:
        return ()
    biases = (pairs.imu(0.0) - pairs.camera @ pairs.lens) / (1e-9 * np.diff(pairs.spans))
    deviations, size, first = max(
        _change(biases, k) for k in range(CHANGE_FEWEST, len(biases) - CHANGE_FEWEST + 1)
    )
    if not (deviations > CHANGE_SIGMAS and size > CHANGE):
        return ()
    row = int(np.searchsorted(recording.imu_timestamps_ns, pairs.spans[first, 0]))
    sentence = (
        f"{recording.imu_place(row)}: gyro: expected one bias that drifts slowly, found that the "
        f"tracks imply a change of the gyroscope's bias by {size:.2g} rad/s about here"
    )
    return (Finding(kind="gyro bias", sentence=sentence, evidence={"change": size, "row": row}),)


def _change(biases: Array, first: int) -> tuple[float, float, int]:
    """Return the largest change of the median of (n, 3): in deviations, its size, and its row."""
    parts = biases[:first], biases[first:]
    medians = [np.median(part, axis=0) for part in parts]
    errors = np.concatenate([np.abs(a - b) for a, b in zip(parts, medians, strict=True)])
    share = math.sqrt(sum(1 / len(part) for part in parts))
    sigma = 1.25 * 1.48 * share * np.maximum(np.median(errors, axis=0), 1e-9)
    change = medians[1] - medians[0]
    return float(np.linalg.norm(change / sigma)), float(np.linalg.norm(change)), first


def regular_stamps(stamps: Array) -> Array:
    """Return stamps (n,) on the nearest line over the numbers of the images, ns."""
    steps = np.diff(stamps)
    number = np.concatenate([[0], np.cumsum(np.round(steps / np.median(steps)))])
    line = np.polynomial.Polynomial.fit(number, (stamps - stamps[0]).astype(np.float64), 1)
    regular: Array = stamps[0] + np.round(line(number)).astype(np.int64)
    return regular


def jitter_findings(images: SequenceImages, recording: Recording) -> tuple[Finding, ...]:
    """Return a finding if tracks contradict the deviations of stamps from a constant rate."""
    stamps = images.stamps
    if len(stamps) < FEWEST:
        return ()
    regular = regular_stamps(stamps)
    jitter = 1e-9 * float(np.std(stamps - regular))
    if jitter < LEAST:
        return ()
    period = 1e-9 * float(np.median(np.diff(regular)))
    turns = turns_of_tracks(images, MOST, CONSECUTIVE * period)
    given = RotationPairs(recording, turns, least_turn=0.0)
    if len(given.camera) < FEWEST:
        return ()
    moved = given.at(regular[np.searchsorted(stamps, given.spans)])
    errors = [pairs.errors(given.lens, pairs.imu(0.0)) for pairs in (given, moved)]
    scale = min(1.48 * float(np.median(np.abs(each))) for each in errors)
    costs = [float(np.log1p(((each / scale) ** 2).sum(axis=1)).sum()) for each in errors]
    ratio = costs[0] - costs[1]
    if not ratio > 2 * math.log(1 / FALSE_ALARM):
        return ()
    sentence = (
        f"{recording.name}: stamps of images: expected times of exposure, found times that "
        f"deviate by {1e3 * jitter:.2g} ms (rms) from a constant rate of {1 / period:.4g} Hz, with "
        "which tracks and gyroscope agree better; are they times of receipt?"
    )
    evidence = {"jitter": jitter, "ratio": ratio, "num_pairs": len(given.camera)}
    return (Finding(kind="stamps", sentence=sentence, evidence=evidence),)
