"""Checks of IMU samples: units, range, finite values."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arguments import as_array
from bundle.errors import InputError

STANDARD_GRAVITY = 9.80665  # m/s^2
# The average over a second is about |g| for a device that is not in free fall.
LEAST_MEAN, MOST_MEAN = 0.7, 1.3
DEGREES_SUSPECTED = 2 * np.pi * 5  # rad/s, limit of the median: five turns per second


def check_imu_samples(
    gyro: ArrayLike,
    accel: ArrayLike,
    *,
    gyro_range: float | None = None,
    accel_range: float | None = None,
) -> None:
    """Raise an error for samples with wrong units, saturated or invalid values.

    Args:
        gyro: (n, 3) angular rates in rad/s.
        accel: (n, 3) specific forces in m/s^2.
        gyro_range: largest rate that the gyroscope measures, in rad/s; None: unknown.
        accel_range: largest acceleration that the accelerometer measures, in m/s^2; None: unknown.

    Raises:
        InputError: an array has another shape, a number is not finite, or a sample is saturated (at
            the end of the sensor's range). Also if accelerations seem to be in g instead of m/s^2,
            or rates in degrees.
    """
    samples = {name: _rows(name, given) for name, given in (("gyro", gyro), ("accel", accel))}
    if len(samples["gyro"]) != len(samples["accel"]):
        raise InputError(
            f"gyro, accel: expected the same number of rows, found {len(samples['gyro'])} and "
            f"{len(samples['accel'])}"
        )
    for name, limit, unit in (("gyro", gyro_range, "rad/s"), ("accel", accel_range, "m/s^2")):
        if limit is None:
            continue
        clipped = np.argwhere(np.abs(samples[name]) >= 0.999 * limit)
        if len(clipped):
            row, axis = clipped[0]
            raise InputError(
                f"{name}[{row}, {axis}]: expected less than the range of {limit:g} {unit}, found "
                f"{samples[name][row, axis]:g}: {len(clipped)} saturated values"
            )
    suspected = suspected_units(samples["gyro"], samples["accel"])
    if suspected:
        raise InputError(suspected)


def suspected_units(gyro: NDArray[np.float64], accel: NDArray[np.float64]) -> str:
    """Return a sentence if samples (n, 3) seem to be in g or degrees, otherwise ""."""
    if not len(gyro):
        return ""
    mean = float(np.linalg.norm(accel, axis=1).mean())
    if LEAST_MEAN < mean < MOST_MEAN:
        return (
            f"accel: expected m/s^2, found a mean of {mean:.3g}: probably g "
            f"(1 g = {STANDARD_GRAVITY} m/s^2)"
        )
    median = float(np.median(np.linalg.norm(gyro, axis=1)))
    if median > DEGREES_SUSPECTED:
        return f"gyro: expected rad/s, found a median rate of {median:.3g}: probably degrees"
    return ""


def _rows(name: str, given: ArrayLike) -> NDArray[np.float64]:
    rows = as_array(name, given)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"{name}: expected shape (n, 3), found {rows.shape}")
    wrong = np.argwhere(~np.isfinite(rows))
    if len(wrong):
        row, axis = wrong[0]
        raise InputError(
            f"{name}[{row}, {axis}]: expected a finite number, found {rows[row, axis]}"
        )
    return rows
