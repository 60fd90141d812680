"""Jitter of the stamps of images, by the rotations of tracks and gyroscope.

A camera with a constant rate exposes image k at a + k b; stamps of receipt are late by different
times. If the stamps deviate from the nearest such line, the rotations of the tracks between
consecutive images decide between both. With e the errors of :mod:`rotation_check` in units of
their robust deviation under the better of both,

    T = sum log(1 + |e|^2, given stamps) - sum log(1 + |e|^2, stamps on the line)

is twice a log-likelihood ratio. If the given stamps are right, the expectation of the ratio is 1,
so that T exceeds 2 log(1 / p) with a probability of at most p (Markov). Consecutive images share
one stamp only, so that the errors of pairs are nearly independent.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bundle.inertial.tracking.rotation_check import RotationPairs
from bundle.inertial.tracking.track_turns import turns_of_tracks
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.interface.finding import Finding
from bundle.model.rigid_motions import rotation_matrices
from bundle.model.sequence.sequence import Recording

Array = np.ndarray[Any, Any]

LEAST = 1e-3  # s: rms of deviations below which nothing is compared
FALSE_ALARM = 1e-4
FEWEST, MOST = 30, 300  # pairs of images
CONSECUTIVE = 2 / 3  # of a period: least time between the images of a pair; most is twice this


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
    lens = rotation_matrices(np.array(recording.calibration.camera_from_imu)[None, :4])[0]
    moved = given.at(regular[np.searchsorted(stamps, given.spans)])
    errors = [pairs.errors(lens, pairs.imu(0.0)) for pairs in (given, moved)]
    scale = min(1.48 * float(np.median(np.abs(each))) for each in errors)
    costs = [float(np.log1p(((each / scale) ** 2).sum(axis=1)).sum()) for each in errors]
    ratio = costs[0] - costs[1]
    if not ratio > 2 * math.log(1 / FALSE_ALARM):
        return ()
    sentence = (
        f"{recording.name}: stamps of images: expected a constant rate of {1 / period:.4g} Hz, "
        f"with which tracks and gyroscope agree better, found deviations of {1e3 * jitter:.2g} ms "
        "(rms): times of receipt in place of exposure?"
    )
    evidence = {"jitter": jitter, "ratio": ratio, "num_pairs": len(given.camera)}
    return (Finding(kind="stamps", sentence=sentence, evidence=evidence),)
