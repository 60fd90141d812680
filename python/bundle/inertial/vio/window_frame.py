"""Frame of a window: stamp, state, tracks, and the IMU interval since the previous frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from bundle.base.records import dataclass
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.vio.landmark_table import FrameTracks
from bundle.model.sequence.calibration import ImuNoise

Array = np.ndarray[Any, Any]

NEGLIGIBLE_ANGLE = 0.02  # rad: the first-order correction is accurate to 6e-5 rad


@dataclass(frozen=True, eq=False)
class ImuInterval:
    """IMU samples between two images.

    Rates (n, 3) rad/s, forces (n, 3) m/s^2, durations (n,) s.

    With midpoint there are n + 1 rows of rates and forces: a sample at each end of a duration.

    Attributes:
        doubt: additional variances of a rotation (rad^2) and of a velocity (m^2/s^2), per axis, due
            to gaps in the recording.
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
    """Frame of a window.

    Attributes:
        stamp: stamp in ns.
        state: state (16,).
        tracks: tracks of its image, without those marginalised into a prior.
        interval: samples since the previous frame; None for the first.
        inertia: the same samples, preintegrated.
        anchor: first estimate, once the frame is in a prior (first-estimate Jacobians, FEJ).
        is_keyframe: False for the newest frame until it becomes one.
    """

    stamp: int
    state: Array
    tracks: FrameTracks
    interval: ImuInterval | None = None
    inertia: Preintegration | None = None
    anchor: Array | None = None
    is_keyframe: bool = False


def repropagate(frames: Sequence[WindowFrame]) -> int:
    """Repropagate intervals with biases too far for first order; return their number.

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
