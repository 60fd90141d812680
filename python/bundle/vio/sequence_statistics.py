"""Figures of a sequence: rates, overlap, noise while it stands still, excitation.

A vehicle is at rest as long as its tracks stay where they were first seen, to within their noise,
and the mean rate stays what it was. Samples alone do not tell: rotors that spin on the ground shake
an accelerometer by more than slow flight moves it.

White noise of density s, sampled at f Hz, has a standard deviation of s sqrt(f) per sample;
differences of neighbouring samples, divided by sqrt(2), give it without what changes slowly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.inertial import excitation
from bundle.vio.sequence import Sequence
from bundle.vio.sequence_findings import GAP

__all__ = ["SequenceStatistics", "at_rest", "sequence_statistics"]

Array = NDArray[np.float64]

REST_SIGMAS = 3.0  # median displacement of the tracks; noise alone gives 1.7
REST_RATE = 0.03  # rad/s: change of the mean rate
REST_WINDOW = 0.5  # s, of that mean


@dataclass(frozen=True)
class SequenceStatistics:
    """Figures of a sequence.

    Attributes:
        imu_rate, camera_rate: of the median step [Hz].
        num_imu_gaps, num_image_gaps: steps of more than 2.5 periods.
        overlap: seconds that both sensors cover.
        static_start: seconds of rest at the start, 0 if it moves at once.
        gyro_noise_density, accel_noise_density: measured over the rest at the start; nan without.
        excitation: standard deviation of the specific force's length over the sequence [m/s^2].
        verdict: "healthy", "marginal" or "unobservable" (the scale).
        tracks_per_image, track_length: min, median, mean, max.
    """

    imu_rate: float
    camera_rate: float
    num_imu_gaps: int
    num_image_gaps: int
    overlap: float
    static_start: float
    gyro_noise_density: float
    accel_noise_density: float
    excitation: float
    verdict: str
    tracks_per_image: dict[str, float]
    track_length: dict[str, float]


def sequence_statistics(sequence: Sequence) -> SequenceStatistics:
    """Return the figures of a sequence."""
    stamps, images = sequence.imu_timestamps_ns, sequence.image_timestamps_ns
    frames, begin = sequence.frames()
    steps, image_steps = np.diff(stamps), np.diff(frames)
    period = float(np.median(steps)) * 1e-9
    rest = at_rest(sequence)
    still = slice(0, rest)
    duration = 1e-9 * float(stamps[rest - 1] - stamps[0]) if rest else 0.0
    excited = excitation(sequence.accel)
    return SequenceStatistics(
        imu_rate=1 / period,
        camera_rate=1e9 / float(np.median(image_steps)) if len(image_steps) else float("nan"),
        num_imu_gaps=_gaps(steps),
        num_image_gaps=_gaps(image_steps),
        overlap=1e-9 * float(min(stamps[-1], images[-1]) - max(stamps[0], images[0])),
        static_start=duration,
        gyro_noise_density=_white(sequence.gyro[still], period),
        accel_noise_density=_white(sequence.accel[still], period),
        excitation=excited.spread,
        verdict=excited.verdict,
        tracks_per_image=_spread(np.diff(begin)),
        track_length=_spread(np.unique(sequence.track_ids, return_counts=True)[1]),
    )


def at_rest(sequence: Sequence) -> int:
    """Return how many IMU samples at the start are at rest."""
    images, stamps = sequence.image_timestamps_ns, sequence.imu_timestamps_ns
    calibration = sequence.calibration
    xy = calibration.focal * sequence.normalized()
    _, first, track = np.unique(sequence.track_ids, return_index=True, return_inverse=True)
    moved = np.linalg.norm(xy - xy[first[track]], axis=1)
    is_seen_again = first[track] != np.arange(len(xy))
    end = int(images[0])
    begin = sequence.frames()[1]
    for low, high in zip(begin[:-1].tolist(), begin[1:].tolist(), strict=True):
        again = is_seen_again[low:high]
        shift = np.median(moved[low:high][again]) if again.any() else 0.0
        if shift > REST_SIGMAS * calibration.pixel_sigma:
            break
        end = int(images[low])
    samples = int(np.searchsorted(stamps, end, side="right")) if end > images[0] else 0
    size = int(np.searchsorted(stamps, stamps[0] + round(1e9 * REST_WINDOW)))
    if samples < size or size < 2:
        return 0
    means = sequence.gyro[: samples // size * size].reshape(-1, size, 3).mean(axis=1)
    turned = np.flatnonzero(np.abs(means - means[0]).max(axis=1) > REST_RATE)
    return int(turned[0]) * size if len(turned) else samples


def _gaps(steps: NDArray[np.int64]) -> int:
    return int(np.count_nonzero(steps > GAP * np.median(steps))) if len(steps) else 0


def _white(values: Array, period: float) -> float:
    if len(values) < 3:
        return float("nan")
    differences = np.diff(values, axis=0)
    return float(np.sqrt(np.mean(differences.var(axis=0)) / 2 * period))


def _spread(counts: NDArray[np.int64]) -> dict[str, float]:
    return {
        "min": float(counts.min()),
        "median": float(np.median(counts)),
        "mean": float(counts.mean()),
        "max": float(counts.max()),
    }
