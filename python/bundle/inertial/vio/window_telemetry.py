"""Telemetry of a window between two keyframes: times, counts, spectra, alarms."""

from __future__ import annotations

import time
from typing import Any, Protocol

import numpy as np

from bundle.inertial.preintegration.preintegration import excitation
from bundle.inertial.vio.keyframe_record import KeyframeRecord
from bundle.inertial.vio.landmark_table import LandmarkTable
from bundle.inertial.vio.marginal_prior import SLOWEST, MarginalPrior
from bundle.inertial.vio.window_alarms import WindowAlarms
from bundle.inertial.vio.window_frame import WindowFrame, window_sizes
from bundle.interface.window_options import WindowOptions
from bundle.model.rigid_motions import (
    quaternion_inverse,
    quaternion_multiply,
    rotation_matrices,
    vector_from_quaternion,
)
from bundle.model.sequence.calibration import ImuNoise

Array = np.ndarray[Any, Any]

FREE_DEGREES = 4  # position and yaw: neither camera nor IMU measures them
IMAGES_PER_CHECK = 10


class WindowTelemetry:
    """Collector of the values of a :class:`KeyframeRecord`."""

    def __init__(self, window: WindowContents) -> None:
        self.window = window
        options = window.options
        held = 3 * (options.start_position_sigma > 0) + (options.start_yaw_sigma > 0)
        self.expected_nullity = FREE_DEGREES - held
        self.num_rejected_tracks = 0
        self.num_repropagated = 0
        self._last: dict[str, Any] = {}
        self._attitudes: Array | None = None  # (1, 4) of the keyframe of the last record
        self._turned = 0.0
        self._exit: dict[str, Any] | None = None
        self._num_solves = 0
        self._imu_excess: float | None = None
        self._is_new_excess = self.is_quiet = False
        noise = window.noise
        walks = noise.gyro_bias_random_walk, noise.accel_bias_random_walk
        self._alarms = WindowAlarms(options, walks)
        self.num_absorbed = self.num_carried = 0
        self.begin()

    def begin(self) -> None:
        """Start a new image."""
        self._times: dict[str, float] = {}
        self._start = self._lap = time.perf_counter()

    def lap(self, phase: str) -> None:
        """Assign the seconds since the last call to a phase."""
        now = time.perf_counter()
        self._times[phase] = self._times.get(phase, 0.0) + now - self._lap
        self._lap = now

    def wants_expected_cost(self) -> bool:
        """Return True if the next solve must compute the expected cost of its IMU factors."""
        self._num_solves += 1
        return self._num_solves % IMAGES_PER_CHECK == 0

    def solved(self, table: LandmarkTable, window: dict[str, Any], solved: dict[str, Any]) -> None:
        """Store the output of the last solve."""
        self._last = solved
        if solved["expected_imu_cost"] > 0:
            self._imu_excess = solved["costs_after"]["imu"] / solved["expected_imu_cost"]
            self._is_new_excess = True
            if solved["covariance"] is not None:
                newest = self.window.frames[-1]
                self._alarms.know_biases(newest.stamp, newest.state, solved["covariance"])
        self._prior_size = max(sum(len(prior["vector"]) for prior in window["priors"]), 1)
        self._window = table, window

    @property
    def covariance(self) -> Array | None:
        """Covariance of the newest state after the last solve, if it was requested."""
        found: Array | None = self._last.get("covariance")
        return found if self.window.options.covariance else None

    def left(self, frame: WindowFrame, how: str, absorbed: int, carried: int) -> None:
        """Record that the oldest keyframe left the window."""
        self._exit = {"timestamp_ns": frame.stamp, "how": how}
        self.num_absorbed, self.num_carried = absorbed, carried

    def excitation(self) -> tuple[float, str]:
        """Return the excitation of the accelerometer over the window, and its verdict."""
        parts = [f.interval.accel for f in self.window.frames if f.interval is not None]
        if not parts:
            return 0.0, "unobservable"
        found = excitation(np.concatenate(parts))
        return found.spread, found.verdict

    def record(self, reason: str, parallax: float, now: float) -> KeyframeRecord:
        """Return the record of the newest keyframe."""
        window, solved = self.window, self._last
        sizes = window_sizes(*self._window, solved["fill_ratio"])
        newest = window.frames[-1]
        times = {**self._times, "total": now - self._start}
        value, verdict = self.excitation()
        nullity = _nullity(solved["spectrum"]) if len(solved["spectrum"]) else None
        prior = self._prior()
        costs = solved["costs_after"]
        self.is_quiet = verdict == "unobservable"
        sigmas, yaw = self._sigmas(self.covariance, newest.state)
        turned = self._rotation_so_far()
        changes = self._alarms.bias_changes(newest.stamp, newest.state)
        alarms = self._alarms.of(
            newest.state,
            (nullity, self.expected_nullity),
            prior,
            (costs["prior"], self._prior_size),
            verdict,
            (yaw, turned),
            changes,
        )
        alarms += self._alarms.of_imu(self._imu_excess, self._is_new_excess)
        self._is_new_excess = False
        if solved["out_of_time"] and not solved["num_iterations"]:
            alarms += ("no step within the time budget: states are predictions of the IMU",)
        record = KeyframeRecord(
            timestamp_ns=newest.stamp,
            reason=reason,
            parallax=parallax,
            **sizes,
            fill_ratio=solved["fill_ratio"],
            times=times,
            num_iterations=solved["num_iterations"],
            num_rejected=solved["num_rejected"],
            least_radius=solved["least_radius"],
            out_of_time=solved["out_of_time"],
            costs=dict(costs),
            mean_visual_chi2=costs["visual"]
            / (2 * max(sizes["num_observations"] + sizes["num_landmarks"], 1)),
            imu_excess=self._imu_excess,
            nullity=nullity,
            expected_nullity=self.expected_nullity,
            **prior,
            excitation=value,
            excitation_verdict=verdict,
            gyro_bias=_triple(newest.state[10:13]),
            accel_bias=_triple(newest.state[13:16]),
            gyro_bias_sigma=None if sigmas is None else _triple(sigmas[9:12]),
            accel_bias_sigma=None if sigmas is None else _triple(sigmas[12:15]),
            bias_change_sigmas=(float(changes[0, 0]), float(changes[0, 1])),
            yaw_sigma=yaw,
            speed_sigma=_speed_sigma(solved["covariance"], newest.state),
            accumulated_rotation=turned,
            marginalized=self._exit,
            num_absorbed=self.num_absorbed,
            num_carried=self.num_carried,
            num_rejected_tracks=self.num_rejected_tracks,
            num_repropagated=self.num_repropagated,
            alarms=alarms,
        )
        self._exit = None
        self.num_absorbed = self.num_carried = 0
        self.num_rejected_tracks = self.num_repropagated = 0
        return record

    def _rotation_so_far(self) -> float:
        attitudes = self.window.states[:, :4]
        if self._attitudes is not None:
            attitudes = np.vstack([self._attitudes, attitudes[-1:]])
        turns = vector_from_quaternion(
            quaternion_multiply(quaternion_inverse(attitudes[:-1]), attitudes[1:])
        )
        self._turned += float(np.linalg.norm(turns, axis=1).sum())
        self._attitudes = attitudes[-1:]
        return self._turned

    def _prior(self) -> dict[str, Any]:
        names = ("min_eigenvalue", "max_eigenvalue", "ratio", "definiteness", "asymmetry")
        prior = self.window.prior
        values: tuple[float | None, ...] = (None,) * len(names)
        if prior is not None and prior.asymmetry is not None:
            least, most = map(float, prior.spectrum()[[0, -1]])
            values = least, most, prior.oldest_ratio(), prior.definiteness(), prior.asymmetry
        return {f"prior_{name}": value for name, value in zip(names, values, strict=True)}

    def _sigmas(self, covariance: Any, state: Array) -> tuple[Array | None, float | None]:
        if covariance is None:
            return None, None
        sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        up = rotation_matrices(state[None, :4])[0][2]  # R^T e_z
        yaw = _deviation(covariance[:3, :3], up)
        return sigmas, yaw if self.expected_nullity in (0, 3) else None


def _speed_sigma(covariance: Array | None, state: Array) -> float | None:
    """Return the standard deviation of the speed relative to the speed; None for a slow state."""
    velocity = state[7:10]
    square = float(velocity @ velocity)
    if covariance is None or not square >= SLOWEST**2:
        return None
    return _deviation(covariance[6:9, 6:9], velocity) / square


def _deviation(covariance: Array, direction: Array) -> float:
    return float(np.sqrt(np.maximum(direction @ covariance @ direction, 0.0)))


def _nullity(spectrum: Any) -> int:
    """Return the number of eigenvalues, for a unit diagonal, that are rounding errors."""
    values = np.asarray(spectrum)
    return int(np.sum(values < len(values) * np.finfo(float).eps * values[-1]))


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


class WindowContents(Protocol):
    """Protocol of the attributes of a :class:`bundle.SlidingWindow` that its parts use."""

    options: WindowOptions
    frames: list[WindowFrame]
    prior: MarginalPrior | None
    camera_from_imu: Array
    time_offset: float
    gravity: Array
    noise: ImuNoise
    sigma: float

    @property
    def states(self) -> Array:
        """States of the frames (n, 16)."""


def window_arrays(window: WindowContents, table: LandmarkTable, points: Array) -> dict[str, Any]:
    """Return the window in the core's format, without priors."""
    states = window.states
    first_estimates = window.options.jacobians == "first_estimate"
    anchored = [first_estimates and frame.anchor is not None for frame in window.frames]
    anchors = [frame.state if frame.anchor is None else frame.anchor for frame in window.frames]
    return {
        "states": states,
        "anchors": np.array(anchors),
        "anchored": np.array(anchored, np.uint8),
        "camera_from_imu": window.camera_from_imu,
        "time_offset": window.time_offset,
        "refine_camera": window.options.refine_extrinsics,
        "refine_time_offset": window.options.refine_time_offset,
        "points": points,
        "anchor_states": table.anchors,
        "anchor_xy": table.anchor_xy,
        "anchor_velocity": table.anchor_velocity,
        "landmarks": table.landmarks,
        "observers": table.observers,
        "xy": table.xy,
        "xy_velocity": table.velocity,
        "sigma": window.sigma,
        "loss": window.options.loss,
        "loss_scale": window.options.loss_scale,
        "gravity": window.gravity,
        "imu": [frame.inertia.core_motion() for frame in window.frames[1:] if frame.inertia],
    }
