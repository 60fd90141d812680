"""States along a spline of position and angles, and what an IMU measures there.

With R = Rz(yaw) Ry(pitch) Rx(roll) the angular rate in the body's frame is

    w = (roll' - yaw' sin pitch,
         pitch' cos roll + yaw' sin roll cos pitch,
         yaw' cos roll cos pitch - pitch' sin roll)

and the specific force f = R^T (p'' - g). These are the samples "instant". A sensor that integrates
over the interval h up to its next sample measures instead

    w_k = Log(R_k^T R_{k+1}) / h,    f_k = R_k^T ((v_{k+1} - v_k) / h - g)

so that R_{k+1} = R_k Exp(w_k h) and v_{k+1} = v_k + (R_k f_k + g) h are exact.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.model.rotations import (
    quaternion_inverse,
    quaternion_multiply,
    quaternion_rotate,
    vector_from_quaternion,
)
from bundle.synthetic.flight.motions import SPACING
from bundle.synthetic.flight.uniform_spline import spline_at

__all__ = ["GRAVITY", "imu_samples", "motion_at"]

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 0.0, -9.81])


def motion_at(control: Array, times: Array) -> Array:
    """Return (n, 10) rows qx qy qz qw px py pz vx vy vz at times (n,) in seconds."""
    place = spline_at(control, SPACING, times)
    velocity = spline_at(control[:, :3], SPACING, times, 1)
    return np.hstack([_quaternions(place[:, 3:]), place[:, :3], velocity])


def imu_samples(control: Array, times: Array, kind: str) -> tuple[Array, Array]:
    """Return angular rates and specific forces (n, 3) without noise and biases.

    Args:
        control: (m, 6) control points of the motion.
        times: (n,) seconds; the last sample of the kind "interval" repeats the one before.
        kind: "instant" or "interval".
    """
    if kind == "instant":
        angles = spline_at(control[:, 3:], SPACING, times)
        rates = spline_at(control[:, 3:], SPACING, times, 1)
        acceleration = spline_at(control[:, :3], SPACING, times, 2)
        back = quaternion_inverse(_quaternions(angles))
        return _body_rates(angles, rates), quaternion_rotate(back, acceleration - GRAVITY)
    states = motion_at(control, times)
    back = quaternion_inverse(states[:-1, :4])
    step = np.diff(times)[:, None]
    gyro = vector_from_quaternion(quaternion_multiply(back, states[1:, :4])) / step
    accel = quaternion_rotate(back, np.diff(states[:, 7:], axis=0) / step - GRAVITY)
    return np.vstack([gyro, gyro[-1:]]), np.vstack([accel, accel[-1:]])


def _body_rates(angles: Array, rates: Array) -> Array:
    (_, pitch, roll), (d_yaw, d_pitch, d_roll) = angles.T, rates.T
    return np.column_stack(
        [
            d_roll - d_yaw * np.sin(pitch),
            d_pitch * np.cos(roll) + d_yaw * np.sin(roll) * np.cos(pitch),
            d_yaw * np.cos(roll) * np.cos(pitch) - d_pitch * np.sin(roll),
        ]
    )


def _quaternions(angles: Array) -> Array:
    """Return unit quaternions (n, 4) of yaw, pitch, roll (n, 3)."""
    sine, cosine = np.sin(angles / 2), np.cos(angles / 2)
    axes = [np.zeros((len(angles), 4)) for _ in range(3)]
    for index, axis in enumerate((2, 1, 0)):
        axes[index][:, axis], axes[index][:, 3] = sine[:, index], cosine[:, index]
    return quaternion_multiply(quaternion_multiply(axes[0], axes[1]), axes[2])
