"""Inertia: IMU samples preintegrated, the factors that they are, and what they can tell."""

from bundle.inertial.imu_factors import BiasWalkFactor, ImuFactor
from bundle.inertial.imu_noise import ImuNoise
from bundle.inertial.imu_samples import check_imu_samples
from bundle.inertial.motion_excitation import Excitation, excitation
from bundle.inertial.preintegration import Preintegration
from bundle.inertial.propagation import propagate
from bundle.inertial.repropagation import Repropagation

__all__ = [
    "BiasWalkFactor",
    "Excitation",
    "ImuFactor",
    "ImuNoise",
    "Preintegration",
    "Repropagation",
    "check_imu_samples",
    "excitation",
    "propagate",
]
