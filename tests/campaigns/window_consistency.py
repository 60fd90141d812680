"""Is a window as certain as it is right? NEES over flights, with and without first estimates.

``python -m tests.campaigns.window_consistency [FLIGHTS [PICTURE]]`` flies that often (50) with each
kind of Jacobians, from the true first states but for the heading, which is known as a compass knows
it: to 6 degrees (1 sigma). Nothing that a camera and an IMU measure says more of it, so that a
consistent estimator ends as uncertain as it began. The errors of the first headings are the
quantiles of their normal distribution, in a shuffled order: their mean square does not scatter.

The normalised squared error of the newest state, yaw (1 degree of freedom) and position (3),
averaged over flights and the later half of the time, is 1 per degree for a consistent estimator.
With current estimates the prior and the live factors are blind along different directions; yaw
seems known, its sigma falls while its error grows (J. A. Hesch et al., Consistency analysis and
improvement of vision-aided inertial navigation, 2014; T.-C. Dong-Si, A. I. Mourikis, Motion
tracking with fixed-lag smoothing: algorithm and consistency analysis, 2011). From a heading that is
known to a hundredth of a degree, as the window's default has it, nothing can be gained, and all
kinds are consistent.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import norm

from bundle.inertial.vio.sequence_images import SequenceImages
from bundle.inertial.vio.sliding_window import SlidingWindow
from bundle.inertial.vio.trajectory_comparison import states_at
from bundle.synthetic.synthetic_flight import SyntheticFlight, synthesize_flight

Array = np.ndarray[Any, Any]

SECONDS = 30.0
START, SPACING = 6, 4  # keyframes of the start, images between them
KINDS = ("first_estimate", "current", "relinearize_prior")
YAW_SIGMA = 6.0  # degrees, of the first heading


def fly(seed: int, seconds: float = SECONDS) -> SyntheticFlight:
    return synthesize_flight(
        seed=seed, duration=seconds, rest=1.0, pixel_noise=1.0, num_tracks=40, imu_noise_scale=1.0
    )


def turned(states: Array, yaw: float) -> Array:
    """Turn states about the vertical through the first position."""
    turn, first = Rotation.from_rotvec([0, 0, yaw]), states[0, 4:7]
    result = states.copy()
    result[:, :4] = (turn * Rotation.from_quat(states[:, :4])).as_quat()
    result[:, 4:7] = first + turn.apply(states[:, 4:7] - first)
    result[:, 7:10] = turn.apply(states[:, 7:10])
    return result


def headings(count: int) -> Array:
    """Return errors of the first headings, radians: quantiles of mean square YAW_SIGMA^2."""
    quantiles = norm.ppf((np.arange(count) + 0.5) / count)
    quantiles *= np.sqrt(count / max((quantiles**2).sum(), 1e-9))
    return np.radians(YAW_SIGMA) * np.random.default_rng(0).permutation(quantiles)


def follow(flight: SyntheticFlight, jacobians: str, seed: int, yaw: float, **options: Any) -> Array:
    """Return per keyframe: seconds, yaw error and sigma, NEES of the position, rotation made.

    ``seed``: of the biases' errors; ``yaw``: error of the first heading, radians.
    """
    sequence = flight.sequence
    images = SequenceImages(sequence)

    def true_state(k: int) -> Array:
        return states_at(flight.ground_truth, images.stamps[[k]])[0]

    first = int(np.searchsorted(images.stamps, images.stamps[0] + 2_000_000_000))
    begin = [first + SPACING * k for k in range(START)]
    settings: dict[str, Any] = {
        "imu_noise_scale": 1.0,
        "loss": "trivial",
        "start_position_sigma": 1e-3,
        "start_yaw_sigma": YAW_SIGMA,
        "start_gyro_bias_sigma": 1e-3,
        "start_accel_bias_sigma": 0.02,
        "covariance": True,
        "time_budget": 10.0,
        "max_num_iterations": 20,
        "function_tolerance": 1e-8,
        "jacobians": jacobians,
    }
    window = SlidingWindow(
        sequence.calibration.camera_from_imu,
        sequence.calibration.noise,
        sequence.calibration.focal,
        **settings | options,
    )
    states = np.array([true_state(k) for k in begin])
    rng = np.random.default_rng(seed)
    states[:, 10:13] += rng.normal(0, settings["start_gyro_bias_sigma"], 3)
    states[:, 13:16] += rng.normal(0, settings["start_accel_bias_sigma"], 3)
    window.start(
        images.stamps[begin],
        turned(states, yaw),
        [images.tracks(k) for k in begin],
        images.intervals(begin),
    )
    rows, rotation, last = [], 0.0, true_state(begin[-1])
    for k in range(begin[-1] + 2, len(images), 2):
        interval = images.interval(window.frames[-1].stamp, k)
        record = window.add_frame(images.stamp(k), interval, images.tracks(k))
        true = true_state(k)
        rotation += (Rotation.from_quat(last[:4]).inv() * Rotation.from_quat(true[:4])).magnitude()
        last = true
        if record is None or window.covariance is None or record.yaw_sigma is None:
            continue
        state = window.frames[-1].state
        off = (Rotation.from_quat(state[:4]) * Rotation.from_quat(true[:4]).inv()).as_rotvec()[2]
        error = state[4:7] - true[4:7]
        nees = float(error @ np.linalg.solve(window.covariance[3:6, 3:6], error))
        rows.append(
            [
                1e-9 * float(images.stamps[k] - images.stamps[0]),
                off,
                record.yaw_sigma,
                nees,
                rotation,
            ]
        )
    return np.array(rows)


def summary(runs: list[Array]) -> tuple[float, float]:
    """Return NEES per degree of freedom of yaw and of position, over the later half."""
    late = [run[len(run) // 2 :] for run in runs]
    yaw = float(np.mean([np.mean((r[:, 1] / r[:, 2]) ** 2) for r in late]))
    position = float(np.mean([np.mean(r[:, 3]) / 3 for r in late]))
    return yaw, position


def main(flights: int, picture: str | None) -> None:
    runs: dict[str, list[Array]] = {kind: [] for kind in KINDS}
    for seed, yaw in enumerate(headings(flights)):
        flight = fly(seed)
        for kind in KINDS:
            runs[kind].append(follow(flight, kind, seed, float(yaw)))
        line = "  ".join(
            f"{kind} {summary(runs[kind])[0]:.2f} {summary(runs[kind])[1]:.2f}" for kind in KINDS
        )
        print(f"{seed + 1:3d} flights, NEES of yaw and position: {line}", flush=True)
    if picture:
        draw(runs, picture)


def draw(runs: dict[str, list[Array]], picture: str) -> None:
    """Plot the signature: sigma of yaw and its true error over the rotation made."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(10, 4), sharey=True)
    for axis, kind in zip(axes, ("first_estimate", "current"), strict=True):
        count = min(len(run) for run in runs[kind])
        stack = np.array([run[:count] for run in runs[kind]])
        turned = np.degrees(stack[:, :, 4].mean(axis=0))
        axis.plot(turned, np.degrees(stack[:, :, 2].mean(axis=0)), label="sigma that it reports")
        axis.plot(
            turned, np.degrees(np.sqrt((stack[:, :, 1] ** 2).mean(axis=0))), label="true error, rms"
        )
        axis.set(title=f"Jacobians: {kind.replace('_', ' ')}", xlabel="rotation made, degrees")
        axis.legend()
    axes[0].set_ylabel("yaw, degrees")
    figure.tight_layout()
    figure.savefig(picture, dpi=110)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50, sys.argv[2] if len(sys.argv) > 2 else None)
