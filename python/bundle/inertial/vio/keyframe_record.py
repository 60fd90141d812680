"""Keyframes of a window: the rule that selects them, and the telemetry of each.

Depth has the relative error sigma_z / z = sigma_d / d for a parallax d: at f = 460 px and sigma_d =
0.5 px, 10 px give 5 %. A frame with less parallax costs time and adds little, unless few
tracks are left or the IMU interval becomes long. Without translation there is no parallax, and no
keyframe is added.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, field
from typing import Any

import numpy as np

from bundle.base.records import dataclass
from bundle.inertial.vio.landmark_table import FrameTracks
from bundle.interface.window_options import WindowOptions


@dataclass(frozen=True)
class KeyframeRecord:
    """Telemetry of a keyframe.

    Costs are 1/2 sum rho, times are seconds, None means not measured.

    Attributes:
        timestamp_ns: stamp of the image.
        reason: reason for the keyframe: start, parallax, tracks or time.
        parallax: median motion of the tracks since the previous keyframe, in pixels.
        window_size: number of frames in the solve.
        num_landmarks, num_observations: counts of the solve; observations exclude those of anchors.
        num_rows: number of residuals, including those of the prior.
        num_columns: number of unknowns, including landmarks.
        num_prior_columns: number of coordinates of the prior, which couples all of them.
        num_information_nonzeros: nnz(Lambda) of the window, both triangles and the diagonal.
        num_reduced_nonzeros: the same after elimination of the landmarks.
        num_factor_nonzeros: nnz(L) of the reduced matrix.
        fill_ratio: fill-in: nonzeros of the factor relative to the reduced matrix (1 if dense).
        times: seconds per phase: preintegration, assembly, solve, marginalization, total.
        num_iterations, num_rejected: attempted steps and rejected steps.
        least_radius: smallest trust region radius of a step; the damping lambda is its reciprocal.
        out_of_time: True if the time budget ended the solve.
        costs: costs by family after the solve: visual, imu, bias_walk, prior. That of the prior is
            0 at its own minimum, and about 0.1 per coordinate in healthy windows.
        mean_visual_chi2: visual cost per residual; 0.5 if sigma is correct.
        imu_excess: cost of the IMU relative to its expectation from the noise, evaluated every ten
            images or so. Below 1 if the noise is set large enough, several times that if camera and
            IMU are inconsistent. None before the first evaluation.
        nullity, expected_nullity: dimension of the null space; 4 is expected without priors on the
            start.
        prior_min_eigenvalue: smallest eigenvalue of the prior's information; a rounding error near
            0 if the prior has a null space, such as position and yaw.
        prior_max_eigenvalue: largest eigenvalue.
        prior_ratio: ratio of smallest and largest eigenvalue of the information on the oldest frame
            given all others, with unit diagonal; healthy above 1e-6 without a trend.
        prior_definiteness: the same for the whole prior: near 0 up to rounding; negative if lost
            digits made it indefinite.
        prior_asymmetry: relative asymmetry before the prior is symmetrised.
        excitation, excitation_verdict: standard deviation of |a| - g over the window, m/s^2.
        gyro_bias, accel_bias: biases of the newest state, with their sigmas if requested.
        bias_change_sigmas: largest changes of both biases since an earlier estimate, in sigmas of
            it and of the random walk; below 4 in healthy windows.
        yaw_sigma: standard deviation of the newest yaw, rad; None without covariance or with a free
            yaw.
        speed_sigma: relative standard deviation of the newest speed, and of the scale while nothing
            accelerates. None below 0.5 m/s, or without covariance; that is also computed while the
            accelerometer is quiet, and with each imu_excess.
        accumulated_rotation: sum of rotation angles between keyframes since the start, rad.
        marginalized: stamp of the keyframe that left the window, or None, and the method.
        num_absorbed: landmarks that were marginalised into the prior.
        num_carried: landmarks of the removed keyframe that continue from their next image.
        num_rejected_tracks: number of outliers.
        num_repropagated: intervals that were integrated again at new biases.
        alarms: sentences; empty for healthy windows.
    """

    timestamp_ns: int
    reason: str
    parallax: float
    window_size: int
    num_landmarks: int
    num_observations: int
    num_rows: int
    num_columns: int
    num_prior_columns: int
    num_information_nonzeros: int
    num_reduced_nonzeros: int
    num_factor_nonzeros: int
    fill_ratio: float
    times: dict[str, float]
    num_iterations: int
    num_rejected: int
    least_radius: float | None
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
    bias_change_sigmas: tuple[float, float]
    yaw_sigma: float | None
    speed_sigma: float | None
    accumulated_rotation: float
    marginalized: dict[str, Any] | None
    num_absorbed: int
    num_carried: int
    num_rejected_tracks: int
    num_repropagated: int
    alarms: tuple[str, ...] = field(default=())

    def asdict(self) -> dict[str, Any]:
        """Return the record for JSON."""
        return asdict(self)


def alarms_by_kind(records: Iterable[KeyframeRecord]) -> dict[str, list[tuple[int, str]]]:
    """Return alarms with the stamps of their keyframes, grouped by the text before the colon."""
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
    """Return the reason for a keyframe ("" if it is not a keyframe), and the median parallax [px].

    ``focal`` is in pixels per unit of normalised coordinates; ``translation`` and ``seconds`` are
    between both frames.
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
