"""What a window reports of each keyframe.

When a frame becomes a keyframe, and why.

Depth is known to sigma_z / z = sigma_d / d for a parallax d: at f = 460 px and sigma_d = 0.5 px,
10 px are 5 %. A frame that adds less only costs time, unless tracks run out or the IMU is
integrated for too long. Without translation there is no parallax, whatever the image does: nothing
is added.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from bundle.inertial.vio.landmark_table import FrameTracks
from bundle.interface.window_options import WindowOptions

__all__ = ["KeyframeRecord", "alarms_by_kind", "keyframe_reason"]


@dataclass(frozen=True)
class KeyframeRecord:
    """Telemetry of a keyframe; costs are 1/2 sum rho, times seconds, None where not measured.

    Attributes:
        timestamp_ns: of the image.
        reason: why it became a keyframe: start, parallax, tracks or time.
        parallax: median motion of the tracks since the keyframe before, pixels.
        window_size: frames in the solve.
        num_landmarks, num_observations: in the solve, observations beyond the anchor's.
        num_rows: residuals, those of the prior among them.
        num_columns: unknowns, landmarks among them.
        fill_ratio: nonzeros of the factor beside those of the reduced matrix (1 where dense).
        times: seconds per phase: preintegration, assembly, solve, marginalization, total.
        num_iterations, num_rejected: steps tried and those rejected.
        out_of_time: the budget ended the solve.
        costs: by family after the solve: visual, imu, bias_walk, prior. The prior's is 0 at its own
            minimum, and about 0.1 a coordinate in healthy windows.
        mean_visual_chi2: visual cost per residual, 0.5 where sigma is right.
        imu_excess: cost of the IMU beside what its noise explains, of a solve every ten images or
            so; below 1 where the noise is taken large enough, several times that where camera and
            IMU contradict each other. None before the first.
        nullity, expected_nullity: directions that nothing sees; 4 without priors on the start.
        prior_min_eigenvalue: smallest of the prior's information; rounding about 0 where it says
            nothing along some direction, as along position and yaw.
        prior_max_eigenvalue: largest.
        prior_ratio: smallest beside largest eigenvalue of the information on the oldest frame given
            all others, its diagonal scaled to 1; healthy above 1e-6 without a trend.
        prior_definiteness: the same of the whole prior: rounding about 0, negative where too few
            digits left it indefinite.
        prior_asymmetry: relative, before the prior is made symmetric.
        excitation, excitation_verdict: standard deviation of |a| - g over the window, m/s^2.
        gyro_bias, accel_bias: of the newest state, with their sigmas where asked for.
        yaw_sigma: of the newest state, rad; None without covariance or with a free yaw.
        accumulated_rotation: rad, of all turns from keyframe to keyframe since the start.
        marginalized: stamp of the keyframe that left, or None, and how.
        num_absorbed: landmarks that went into the prior.
        num_carried: landmarks of the keyframe that left that go on from their next image.
        num_rejected_tracks: outliers.
        num_repropagated: intervals that were integrated anew at new biases.
        alarms: sentences; none on healthy windows.
    """

    timestamp_ns: int
    reason: str
    parallax: float
    window_size: int
    num_landmarks: int
    num_observations: int
    num_rows: int
    num_columns: int
    fill_ratio: float
    times: dict[str, float]
    num_iterations: int
    num_rejected: int
    out_of_time: bool
    costs: dict[str, float]
    mean_visual_chi2: float | None
    imu_excess: float | None
    nullity: int | None
    expected_nullity: int
    prior_min_eigenvalue: float | None
    prior_max_eigenvalue: float | None
    prior_ratio: float | None
    prior_definiteness: float | None
    prior_asymmetry: float | None
    excitation: float
    excitation_verdict: str
    gyro_bias: tuple[float, float, float]
    accel_bias: tuple[float, float, float]
    gyro_bias_sigma: tuple[float, float, float] | None
    accel_bias_sigma: tuple[float, float, float] | None
    yaw_sigma: float | None
    accumulated_rotation: float
    marginalized: dict[str, Any] | None
    num_absorbed: int
    num_carried: int
    num_rejected_tracks: int
    num_repropagated: int
    alarms: tuple[str, ...] = field(default=())

    def asdict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)


def alarms_by_kind(records: Iterable[KeyframeRecord]) -> dict[str, list[tuple[int, str]]]:
    """Return the alarms with the stamps of their keyframes, by what they say before the colon."""
    found: dict[str, list[tuple[int, str]]] = {}
    for record in records:
        for alarm in record.alarms:
            found.setdefault(alarm.partition(":")[0], []).append((record.timestamp_ns, alarm))
    return found


Array = np.ndarray[Any, Any]


def keyframe_reason(
    last: FrameTracks,
    new: FrameTracks,
    focal: float,
    translation: float,
    seconds: float,
    options: WindowOptions,
) -> tuple[str, float]:
    """Return why the new frame is a keyframe, "" if it is none, and the median parallax in pixels.

    Args:
        last: tracks of the last keyframe.
        new: tracks of the frame.
        focal: pixels per unit of normalised coordinates.
        translation: distance between both, metres.
        seconds: time between both.
        options: the bounds.
    """
    _, a, b = np.intersect1d(last.ids, new.ids, assume_unique=True, return_indices=True)
    parallax = 0.0
    if len(a):
        parallax = focal * float(np.median(np.linalg.norm(new.xy[b] - last.xy[a], axis=1)))
    if translation < options.min_translation:
        return "", parallax
    if parallax > options.min_parallax:
        return "parallax", parallax
    if len(a) < options.min_tracks:
        return "tracks", parallax
    if seconds > options.max_interval:
        return "time", parallax
    return "", parallax
