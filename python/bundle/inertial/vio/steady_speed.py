"""Prior on steady speed while the accelerometer has no excitation.

At constant velocity nothing measures the scale: a wrong pitch with a wrong accelerometer bias, or
drift of the monocular scale, changes the speed like a true acceleration. An assumption remains:
where |a| does not vary, the platform keeps its speed,

    r = (|v_j| - |v_i|) / (sigma T)

between frames T seconds apart. The Jacobian is the direction of each velocity. A rotation about
gravity moves a velocity by g x v, which is perpendicular to it: yaw stays free if the direction is
evaluated at the same linearization point as the other Jacobians. Before a solve, this point is
known only for frames with a first estimate, those in the window's prior. The newest frames follow
when they get one.

The assumption is wrong for a platform that brakes gently and evenly: 0.3 m/s^2 changes |a| by only
0.005 m/s^2. It is therefore optional, and sigma sets its weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from bundle.inertial.vio.marginal_prior import MOTION, MarginalPrior
from bundle.inertial.vio.window_frame import WindowFrame

__all__ = ["steady_speed"]

Array = np.ndarray[Any, Any]

SLOWEST = 0.5  # m/s: a slower velocity has no reliable direction
COLUMNS = 9  # velocity and two biases


def steady_speed(
    frames: Sequence[WindowFrame], sigma: float, square_root: bool
) -> MarginalPrior | None:
    """Return a prior on the changes of speed between consecutive frames.

    Args:
        frames: frames in ascending time.
        sigma: standard deviation of the mean acceleration along the path between two frames, m/s^2.
        square_root: form of the prior.

    Returns:
        None if no two consecutive frames have first estimates faster than 0.5 m/s.
    """
    rows, residuals = [], []
    for k, (before, after) in enumerate(pairwise(frames)):
        first, second = _direction(before), _direction(after)
        if first is None or second is None:
            continue
        weight = 1 / (sigma * 1e-9 * (after.stamp - before.stamp))
        row = np.zeros(COLUMNS * len(frames))
        row[COLUMNS * k : COLUMNS * k + 3] = -weight * first
        row[COLUMNS * (k + 1) : COLUMNS * (k + 1) + 3] = weight * second
        rows.append(row)
        speeds = [float(np.linalg.norm(frame.state[7:10])) for frame in (before, after)]
        residuals.append(weight * (speeds[1] - speeds[0]))
    if not rows:
        return None
    m, r = np.array(rows), np.array(residuals)
    keys = tuple((frame.stamp, MOTION) for frame in frames)
    points = np.array([frame.state for frame in frames])
    if square_root:
        return MarginalPrior(keys, points, True, m, r)
    return MarginalPrior(keys, points, False, m.T @ m, -m.T @ r, 0.5 * float(r @ r))


def _direction(frame: WindowFrame) -> Array | None:
    """Return the direction of a frame's first velocity estimate; None if missing or too slow."""
    if frame.anchor is None:
        return None
    velocity = frame.anchor[7:10]
    speed = float(np.linalg.norm(velocity))
    return np.asarray(velocity / speed) if speed > SLOWEST else None
