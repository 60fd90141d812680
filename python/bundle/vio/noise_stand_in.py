"""Noise of an IMU, until :mod:`bundle.inertial` has it."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ImuNoise"]


@dataclass(frozen=True)
class ImuNoise:
    """Densities as data sheets give them: rad/s/sqrt(Hz), m/s^2/sqrt(Hz), and their walks."""

    gyro_noise_density: float
    accel_noise_density: float
    gyro_bias_random_walk: float
    accel_bias_random_walk: float
    integration_covariance: float = 1e-8
