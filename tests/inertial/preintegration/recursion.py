"""Preintegration by dense matrices and SciPy's exponential, sample by sample: the oracle.

Errors are in the order rotation, position, velocity, gyroscope bias, accelerometer bias; the
rotation's is that of R Exp(d).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, expm
from scipy.spatial.transform import Rotation

I3 = np.eye(3)


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0.0]])


def right_jacobian(w):
    """By the exponential of a matrix twice the size: its corner is the integral of Exp(-s w)."""
    block = np.zeros((6, 6))
    block[:3, :3], block[:3, 3:] = -skew(w), I3
    return expm(block)[:3, 3:]


def log(rotation):
    return Rotation.from_matrix(rotation).as_rotvec()


@dataclass
class Motion:
    rotation: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    by_bias: np.ndarray  # (9, 6)
    covariance: np.ndarray  # (15, 15)


def integrate(noise, gyro, accel, dt, gyro_bias, accel_bias, midpoint=False):
    """`gyro` and `accel` have a row more than `dt` by midpoint."""
    rotation, position, velocity = I3, np.zeros(3), np.zeros(3)
    by_bias, covariance = np.zeros((9, 6)), np.zeros((15, 15))
    for k, step in enumerate(dt):
        rate = (gyro[k] + gyro[k + 1]) / 2 if midpoint else gyro[k]
        turn = (rate - gyro_bias) * step
        start, end = accel[k] - accel_bias, accel[k + 1] - accel_bias if midpoint else None
        after = rotation @ expm(skew(turn))
        by_gyro = -right_jacobian(turn) * step
        # What errors of rotation and bias do to the force, in the frame of the start.
        if midpoint:
            force = (rotation @ start + after @ end) / 2
            through_turn = -after @ skew(end) / 2
            by_turn = -rotation @ skew(start) / 2 + through_turn @ expm(-skew(turn))
            force_by_gyro = through_turn @ by_gyro
            mean = (rotation + after) / 2
        else:
            force = rotation @ start
            by_turn, force_by_gyro = -rotation @ skew(start), np.zeros((3, 3))
            mean = rotation
        shares = {"p": step**2 / 2, "v": step}
        transition = np.eye(15)
        transition[:3, :3], transition[:3, 9:12] = expm(-skew(turn)), by_gyro
        transition[3:6, 6:9] = step * I3
        for row, share in ((3, shares["p"]), (6, shares["v"])):
            transition[row : row + 3, :3] = share * by_turn
            transition[row : row + 3, 9:12] = share * force_by_gyro
            transition[row : row + 3, 12:] = -share * mean
        of_gyro = np.vstack([by_gyro, shares["p"] * force_by_gyro, shares["v"] * force_by_gyro])
        of_accel = np.vstack([np.zeros((3, 3)), shares["p"] * I3, shares["v"] * I3])
        covariance = transition @ covariance @ transition.T
        covariance[:9, :9] += of_gyro @ of_gyro.T * noise.gyro_noise_density**2 / step
        covariance[:9, :9] += of_accel @ of_accel.T * noise.accel_noise_density**2 / step
        covariance[3:6, 3:6] += noise.integration_covariance * step * I3
        walks = (noise.gyro_bias_random_walk**2 * I3, noise.accel_bias_random_walk**2 * I3)
        covariance[9:, 9:] += block_diag(*walks) * step
        by_bias = transition[:9, :9] @ by_bias + transition[:9, 9:]
        position = position + velocity * step + force * step**2 / 2
        velocity = velocity + force * step
        rotation = after
    return Motion(rotation, position, velocity, by_bias, covariance)
