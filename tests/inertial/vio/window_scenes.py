"""Windows whose IMU samples are exact, and an independent reading of their residuals."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.vio.landmark_table import FrameTracks
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.sequence.calibration import ImuNoise

Array = np.ndarray[Any, Any]

GRAVITY = np.array([0.0, 0.0, -9.81])
NOISE = ImuNoise(1.7e-3, 2e-2, 2e-4, 3e-3)
# The camera looks along the body's x axis; the body flies with x ahead and z up.
CAMERA_FROM_BODY = Rotation.from_matrix([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
CAMERA = np.r_[CAMERA_FROM_BODY.as_quat(), 0.05, -0.02, 0.03]
FOCAL = 460.0
SECOND = 10**9


class Flight:
    """States at keyframes, the samples between them, and landmarks ahead.

    Samples hold from one to the next, so that integrating them step by step gives the states.
    """

    def __init__(
        self,
        keyframes: int,
        seed: int = 0,
        *,
        period: float = 0.25,
        samples: int = 25,
        landmarks: int = 40,
        gyro_bias: Array | None = None,
        accel_bias: Array | None = None,
        speed: float = 1.0,
        shake: float = 3.0,
    ) -> None:
        rng = np.random.default_rng(seed)
        self.gyro_bias = rng.normal(0, 0.01, 3) if gyro_bias is None else gyro_bias
        self.accel_bias = rng.normal(0, 0.05, 3) if accel_bias is None else accel_bias
        dt = period / samples
        rotation = Rotation.from_rotvec(rng.normal(0, 0.1, 3))
        position, velocity = np.zeros(3), np.array([speed, 0.0, 0.0])
        phases = rng.uniform(0, 2 * np.pi, (2, 3))
        self.stamps = (np.arange(keyframes) * period * SECOND).astype(np.int64)
        states, self.intervals = [], []
        for k in range(keyframes):
            biases = np.r_[self.gyro_bias, self.accel_bias]
            states.append(np.r_[rotation.as_quat(), position, velocity, biases])
            rates, forces = [], []
            for i in range(samples):
                t = (k * samples + i) * dt
                rate = 0.4 * np.sin(1.3 * t + phases[0])
                acceleration = shake * np.sin(2.1 * t + phases[1])
                rates.append(rate + self.gyro_bias)
                forces.append(rotation.inv().apply(acceleration - GRAVITY) + self.accel_bias)
                position = position + velocity * dt + 0.5 * acceleration * dt**2
                velocity = velocity + acceleration * dt
                rotation = rotation * Rotation.from_rotvec(rate * dt)
            self.intervals.append(
                ImuInterval(np.array(rates), np.array(forces), np.full(samples, dt))
            )
        self.intervals.pop()
        self.states = np.array(states)
        middle = self.states[:, 4:7].mean(axis=0)
        self.points = middle + rng.uniform([3, -5, -4], [12, 5, 4], (landmarks, 3))

    def tracks(self, sigma: float = 0.0, seed: int = 1) -> list[FrameTracks]:
        """Observations of each keyframe, with noise of sigma (normalised)."""
        rng = np.random.default_rng(seed)
        found = []
        for state in self.states:
            seen = seen_from(state, CAMERA, self.points)
            front = seen[:, 2] > 0.5
            xy = seen[:, :2] / seen[:, 2:]
            ids = np.flatnonzero(front & (np.abs(xy) < 1.5).all(axis=1))
            noisy = xy[ids] + rng.normal(0, sigma, (len(ids), 2)) if sigma else xy[ids]
            found.append(FrameTracks(ids.astype(np.int64), noisy, np.zeros_like(noisy)))
        return found


def seen_from(state: Array, camera: Array, points: Array) -> Array:
    """Points in the frame of a camera at one state, or at a state per point."""
    body = Rotation.from_quat(state[..., :4]).inv().apply(points - state[..., 4:7])
    return Rotation.from_quat(camera[:4]).apply(body) + camera[4:]


def moved(state: Array, d: Array) -> Array:
    """Retract 15 coordinates."""
    turned = (Rotation.from_quat(state[:4]) * Rotation.from_rotvec(d[:3])).as_quat()
    return np.r_[turned, state[4:] + d[3:]]


def imu_residual(motion: Preintegration, i: Array, j: Array) -> Array:
    """Whitened residual of two states, from its definition."""
    rotation, velocity, position = motion.corrected(i[10:13], i[13:16])
    t = motion.duration
    a, b = Rotation.from_quat(i[:4]), Rotation.from_quat(j[:4])
    r = np.r_[
        (Rotation.from_matrix(rotation).inv() * a.inv() * b).as_rotvec(),
        a.inv().apply(j[4:7] - i[4:7] - i[7:10] * t - 0.5 * GRAVITY * t**2) - position,
        a.inv().apply(j[7:10] - i[7:10] - GRAVITY * t) - velocity,
    ]
    root = np.linalg.cholesky(np.linalg.inv(motion.covariance)).T
    walk = (j[10:] - i[10:]) / np.sqrt(t)
    scales = np.repeat([NOISE.gyro_bias_random_walk, NOISE.accel_bias_random_walk], 3)
    return np.r_[root @ r, walk / scales]


def residuals(window: dict[str, Any], motions: list[Preintegration], x: Array) -> Array:
    """All residuals of a window (trivial loss, no prior) at x: states, points, camera, offset."""
    n = len(window["states"])
    states = np.array([moved(s, x[15 * k : 15 * k + 15]) for k, s in enumerate(window["states"])])
    at = 15 * n
    points = window["points"] + x[at : at + window["points"].size].reshape(-1, 3)
    at += points.size
    camera = np.array(window["camera_from_imu"])
    if window["refine_camera"]:
        turned = Rotation.from_quat(camera[:4]) * Rotation.from_rotvec(x[at : at + 3])
        camera = np.r_[turned.as_quat(), camera[4:] + x[at + 3 : at + 6]]
        at += 6
    offset = window["time_offset"] + (x[at] if window["refine_time_offset"] else 0.0)
    there = points[:, :2] - offset * window["anchor_velocity"]
    rays = np.c_[there, np.ones(len(points))] / points[:, 2:]
    body = Rotation.from_quat(camera[:4]).inv().apply(rays - camera[4:])
    anchor = states[window["anchor_states"]]
    place = Rotation.from_quat(anchor[:, :4]).apply(body) + anchor[:, 4:7]
    seen = seen_from(states[window["observers"]], camera, place[window["landmarks"]])
    xy = window["xy"] - offset * window["xy_velocity"]
    rows = (seen[:, :2] / seen[:, 2:] - xy) / window["sigma"]
    anchors = (points[:, :2] - window["anchor_xy"]) / window["sigma"]
    inertial = [imu_residual(m, states[k], states[k + 1]) for k, m in enumerate(motions)]
    return np.concatenate([rows.ravel(), anchors.ravel(), *inertial])


def jacobian(function: Any, size: int, h: float = 1e-6) -> Array:
    """Central differences about 0."""
    columns = []
    for k in range(size):
        d = np.zeros(size)
        d[k] = h
        columns.append((function(d) - function(-d)) / (2 * h))
    return np.array(columns).T
