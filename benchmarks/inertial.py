"""Preintegration: bundle's batches beside GTSAM's, microseconds of processor time per sample.

Prints a row per implementation and length of the interval between keyframes: all samples of a
minute at 200 Hz, integrated interval by interval with covariance and Jacobians of the biases.
GTSAM takes samples one by one from Python; its manifold variant has our formulas, its default
integrates in the tangent space. The implementations take turns; the table has medians.

Run: python -m benchmarks.inertial [--repeat N] [--json FILE]
"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import bundle
from benchmarks import backend, measure
from benchmarks.backend import OURS

RATE, SAMPLES = 200, 12_000
INTERVALS = (10, 50, 1000)
NOISE = bundle.ImuNoise(1.6968e-4, 2.0e-3, 1.9393e-5, 3.0e-3)

Array = NDArray[np.float64]
Integration = Callable[[Array, Array, Array, int], Array]


def samples() -> tuple[Array, Array, Array]:
    """Return gyro (n, 3), accel (n, 3) and dt (n,) of a lively flight."""
    t = np.arange(SAMPLES) / RATE
    gyro = np.c_[0.8 * np.sin(2 * t), 0.5 * np.cos(1.3 * t), 0.6 * np.sin(0.7 * t)]
    accel = np.c_[2 * np.cos(3 * t), 1.5 * np.sin(2.2 * t), 9.81 + np.sin(1.7 * t)]
    return gyro, accel, np.full(SAMPLES, 1 / RATE)


def by_bundle(gyro: Array, accel: Array, dt: Array, interval: int) -> Array:
    """Return the last delta of position."""
    for start in range(0, len(dt), interval):
        rows = slice(start, start + interval)
        motion = bundle.Preintegration(NOISE)
        motion.integrate(gyro[rows], accel[rows], dt[rows])
    return motion.delta_position


def by_gtsam(variant: str) -> Integration:
    """Return the same by one of GTSAM's classes."""
    import gtsam

    params = gtsam.PreintegrationParams.MakeSharedU(9.81)
    params.setAccelerometerCovariance(np.eye(3) * NOISE.accel_noise_density**2)
    params.setGyroscopeCovariance(np.eye(3) * NOISE.gyro_noise_density**2)
    params.setIntegrationCovariance(np.eye(3) * NOISE.integration_covariance)
    kind = getattr(gtsam, f"PreintegratedImuMeasurements{variant}")

    def integrate(gyro: Array, accel: Array, dt: Array, interval: int) -> Array:
        for start in range(0, len(dt), interval):
            motion = kind(params, gtsam.imuBias.ConstantBias())
            for k in range(start, min(start + interval, len(dt))):
                motion.integrateMeasurement(accel[k], gyro[k], dt[k])
        return np.asarray(motion.deltaPij())

    return integrate


def measured(repeat: int) -> dict[str, dict[str, list[float]]]:
    """Return microseconds of processor time per sample, by implementation and interval, of runs."""
    implementations: dict[str, Integration] = {OURS: by_bundle}
    if importlib.util.find_spec("gtsam") is not None:
        implementations |= {"gtsam manifold": by_gtsam("Manifold"), "gtsam default": by_gtsam("")}
    given = samples()
    took: dict[str, dict[str, list[float]]] = {
        name: {str(interval): [] for interval in INTERVALS} for name in implementations
    }
    for _ in range(repeat):
        for interval in INTERVALS:
            for name, integrate in implementations.items():
                start = time.process_time()
                integrate(*given, interval)
                seconds = time.process_time() - start
                took[name][str(interval)].append(1e6 * seconds / SAMPLES)
    return took


if __name__ == "__main__":
    measure.run_alone(__doc__, measured, backend.inertial_table)
