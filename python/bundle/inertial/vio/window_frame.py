"""Frame of a window: stamp, state, tracks, IMU interval; sizes of the window's normal equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from bundle.base.records import dataclass
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.vio.landmark_table import FrameTracks, LandmarkTable
from bundle.model.sequence.calibration import ImuNoise

Array = np.ndarray[Any, Any]

NEGLIGIBLE_ANGLE = 0.02  # rad: the first-order correction is accurate to 6e-5 rad


@dataclass(frozen=True, eq=False)
class ImuInterval:
    """IMU samples between two images.

    Rates (n, 3) rad/s, forces (n, 3) m/s^2, durations (n,) s.

    With midpoint there are n + 1 rows of rates and forces: a sample at each end of a duration.

    ``doubt``: more variance of a rotation (rad^2) and a velocity (m^2/s^2), per axis, due to gaps.
    """

    gyro: Array
    accel: Array
    dt: Array
    doubt: tuple[float, float] = (0.0, 0.0)

    def then(self, later: ImuInterval) -> ImuInterval:
        """Return the concatenation of both; with midpoint they share the sample between them."""
        shared = len(self.gyro) - len(self.dt)
        return ImuInterval(
            np.concatenate([self.gyro, later.gyro[shared:]]),
            np.concatenate([self.accel, later.accel[shared:]]),
            np.concatenate([self.dt, later.dt]),
            (self.doubt[0] + later.doubt[0], self.doubt[1] + later.doubt[1]),
        )

    def integrated(self, noise: ImuNoise, state: Array, rule: str) -> Preintegration:
        """Return the samples preintegrated at a state's biases, ``doubt`` added to the noise."""
        if self.doubt != (0.0, 0.0):
            seconds = float(self.dt.sum())
            gyro, accel = (
                float(np.sqrt(density**2 + variance / seconds))
                for density, variance in zip(noise.astuple()[:2], self.doubt, strict=True)
            )
            noise = replace(noise, gyro_noise_density=gyro, accel_noise_density=accel)
        result = Preintegration(noise, state[10:13], state[13:16], rule=rule)
        result.integrate(self.gyro, self.accel, self.dt)
        return result


@dataclass(eq=False)
class WindowFrame:
    """Frame of a window."""

    stamp: int  # stamp in ns
    state: Array  # state (16,)
    tracks: FrameTracks  # tracks of its image, without those marginalised into a prior
    interval: ImuInterval | None = None  # samples since the previous frame; None for the first
    inertia: Preintegration | None = None  # the same samples, preintegrated
    anchor: Array | None = None  # first estimate (FEJ), once the frame is in a prior
    is_keyframe: bool = False  # False for the newest frame until it becomes one


def repropagate(frames: Sequence[WindowFrame]) -> int:
    """Repropagate intervals whose biases have moved too far; return their number.

    The first-order error is at most a sixth of the squared angle by which the bias change rotates
    the interval; below NEGLIGIBLE_ANGLE the closed form is skipped.
    """
    count = 0
    for before, frame in pairwise(frames):
        assert frame.inertia is not None
        motion, change = frame.inertia, before.state[10:13] - frame.inertia.gyro_bias
        if motion.duration**2 * float(change @ change) < NEGLIGIBLE_ANGLE**2:
            continue
        if motion.needs_repropagation(before.state[10:13]):
            frame.inertia = motion.repropagated(before.state[10:13], before.state[13:16])
            count += 1
    return count


# Sizes of a window's normal equations: rows, columns, nonzeros before and after elimination.
#
# Two coordinates are coupled if a residual depends on both. A reprojection couples a landmark with
# the pose that anchors it and with the pose that observes it, an IMU factor two consecutive states,
# a prior all its blocks. Eliminating a landmark couples all poses that observe it.


BLOCKS = (6, 9)
"""Coordinates of a state: its pose, which images observe, and its velocity and biases."""
POINT = 3


def window_sizes(table: LandmarkTable, window: dict[str, Any], fill_ratio: float) -> dict[str, Any]:
    """Return the sizes of a window's solve, as named in a :class:`KeyframeRecord`.

    ``fill_ratio``: nonzeros of the factor relative to the reduced matrix; 1 if it is dense.
    """
    states, points = len(window["states"]), len(table.ids)
    camera = np.array([6 * window["refine_camera"], int(window["refine_time_offset"])])
    sizes = np.concatenate([np.tile(BLOCKS, states), camera]).astype(float)
    seen = np.zeros((points, len(sizes)), bool)  # blocks that each landmark is coupled with
    seen[np.arange(points), 2 * table.anchors] = True
    seen[table.landmarks, 2 * table.observers] = True
    observed = np.bincount(table.landmarks, minlength=points) > 0
    seen[observed, 2 * states :] = True
    coupled = np.eye(len(sizes), dtype=bool)
    for first in range(0, 2 * (states - 1), 2):
        coupled[first : first + 4, first : first + 4] = True
    for prior in window["priors"]:
        coupled[np.ix_(prior["blocks"], prior["blocks"])] = True
    direct = coupled.copy()
    for blocks in (2 * table.anchors[table.landmarks], 2 * states, 2 * states + 1):
        direct[2 * table.observers, blocks] = True
        direct[blocks, 2 * table.observers] = True
    reduced = coupled | (seen.T.astype(float) @ seen > 0)
    columns = float(sizes.sum())
    with_points = 2 * POINT * float((seen @ sizes).sum()) + POINT**2 * points
    nonzeros = float(sizes @ reduced @ sizes)
    priors = [len(prior["vector"]) for prior in window["priors"]]
    lower = (nonzeros + columns) / 2
    return {
        "window_size": states,
        "num_landmarks": points,
        "num_observations": len(table.landmarks),
        "num_rows": 2 * (len(table.landmarks) + points) + 15 * (states - 1) + sum(priors),
        "num_columns": int(columns) + POINT * points,
        "num_prior_columns": int(sum(sizes[prior["blocks"]].sum() for prior in window["priors"])),
        "num_information_nonzeros": int(sizes @ direct @ sizes + with_points),
        "num_reduced_nonzeros": int(nonzeros),
        "num_factor_nonzeros": round(
            fill_ratio * lower if fill_ratio != 1 else columns * (columns + 1) / 2
        ),
    }
