"""Scale and bias of rates, jitter of stamps, by the rotations of tracks and gyroscope.

**Scale of rates.** Let c be the rotation of the camera, g that of the IMU, R the rotation of
camera_from_imu. Rates that are k times too large, a bias b, a small rotation a of the camera and a
late clock by d leave, with the rates w at both images and T between them,

    c - R g = s R g + a x R g + d R (w_j - w_i) - T R b,        k = 1 / (1 + s),

by least squares with the information on c, Cauchy weights, and weak priors, without which s and b
are not separable at constant speed. With the right k, only errors of tracks remain. If a larger
residual remains, or s, a or d exceed their priors, another fault affects the rotations: k is
unknown. Without more noise of the samples it is in rays or stamps: forces do not affect rotations.

**Change of the bias.** (g - R^T c) / T is the bias b of each pair. The medians before and after a
time differ by at most 5 deviations in clean flights, by 17 with a turned camera, and by 26 or more
if b jumps by 0.05 rad/s or more.

**Jitter of stamps.** A camera with a constant rate exposes image k at a + k b; stamps of receipt
are late by different times. If the stamps deviate from the nearest such line, the rotations of the
tracks between consecutive images decide between both. With e the errors of :mod:`rotation_check` in
units of their robust deviation under the better of both,

    T = sum log(1 + |e|^2, given stamps) - sum log(1 + |e|^2, stamps on the line)

is twice a log-likelihood ratio. If the given stamps are right, the expectation of the ratio is 1,
so that T exceeds 2 log(1 / p) with a probability of at most p (Markov). Consecutive images share
one stamp only, so that the errors of pairs are nearly independent.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bundle.inertial.tracking.relative_rotation import Turn, turns_of_tracks
from bundle.inertial.tracking.rotation_check import SHIFTS, RotationPairs
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.interface.finding import Finding
from bundle.model.rigid_motions import cross_matrices
from bundle.model.sequence.sequence import Recording
from bundle.model.sequence.sequence_findings import bad_stretches

Array = np.ndarray[Any, Any]

LEAST = 1e-3  # s: rms of deviations below which nothing is compared
FALSE_ALARM = 1e-4
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
    """Return k and its standard deviation, nan beside another fault, and the variance factor."""
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
