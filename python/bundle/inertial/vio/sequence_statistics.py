"""Statistics of a sequence: rates, overlap, noise at rest, excitation.

White noise of density s, sampled at f Hz, has a standard deviation of s sqrt(f) per sample.
Differences of consecutive samples, divided by sqrt(2), measure it without slow changes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.inertial.preintegration.motion_excitation import excitation
from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.inertial.vio.static_start import rest_at_start
from bundle.model.sequence.sequence import Sequence
from bundle.model.sequence.sequence_findings import GAP

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SequenceStatistics:
    """Statistics of a sequence.

    Attributes:
        imu_rate, camera_rate: rates from the median step [Hz].
        num_imu_gaps, num_image_gaps: steps of more than 2.5 periods.
        overlap: seconds covered by both sensors.
        static_start: seconds of rest at the start; 0 if it starts in motion.
        gyro_noise_density, accel_noise_density: measured over the rest at the start; nan without
            rest.
        excitation: standard deviation of the magnitude of the specific force while there are
            images [m/s^2].
        verdict: observability of the scale: "healthy", "marginal" or "unobservable".
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
    """Return the statistics of a sequence."""
    stamps, images = sequence.imu_timestamps_ns, sequence.image_timestamps_ns
    frames, begin = sequence.frames()
    steps, image_steps = np.diff(stamps), np.diff(frames)
    period = float(np.median(steps)) * 1e-9
    _, rest = rest_at_start(SequenceImages(sequence))
    still = slice(0, rest)
    duration = 1e-9 * float(stamps[rest - 1] - stamps[0]) if rest else 0.0
    seen = (stamps >= images[0]) & (stamps <= images[-1])
    excited = excitation(sequence.accel[seen] if np.count_nonzero(seen) > 1 else sequence.accel)
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
