"""Priors of a window: at its start, from marginalisation, on steady speed without excitation.

A marginal prior is indexed by the stamps of its frames, because their positions in the window
change as it slides.

At constant velocity nothing measures the scale: a wrong pitch with a wrong accelerometer bias, or
drift of the monocular scale, changes the speed like a true acceleration. The prior assumes that
the platform keeps its speed while |a| does not vary,

    r = (|v_j| - |v_i|) / (sigma T)

between frames T seconds apart. The Jacobian is the direction of each velocity. A rotation about
gravity moves a velocity by g x v, which is perpendicular to it: yaw stays free if the direction is
evaluated at the same linearization point as the other Jacobians. Before a solve, this point is
known only for frames with a first estimate, those in the window's prior. The newest frames are
included once they have a first estimate.

The assumption is wrong for a platform that brakes gently and evenly: 0.3 m/s^2 changes |a| by only
0.005 m/s^2. It is therefore optional, and sigma sets its weight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.inertial.vio.window_frame import WindowFrame
from bundle.model.rigid_motions import rotation_matrices

Array = np.ndarray[Any, Any]

POSE, MOTION = 0, 1
CAMERA, TIME = "camera", "time offset"
SIZES = (6, 9)
REST_SPEED, REST_DISTANCE = 0.01, 0.005  # sigmas of a platform at rest: m/s, m
CAMERA_TURN, CAMERA_SHIFT = 0.05, 0.05  # sigmas of a refined camera_from_imu: rad, m


@dataclass(frozen=True, eq=False)
class MarginalPrior:
    """Quadratic form of d = (state - points).

    Its cost is 1/2 |M d + v|^2, or c - v^T d + 1/2 d^T M d.
    """

    keys: tuple[tuple[int | str, int], ...]  # (stamp [ns], POSE or MOTION), (CAMERA, 0), (TIME, 0)
    points: Array  # (len(keys), 16), the linearization points, where d is 0
    square_root: bool  # True for the first form
    matrix: Array  # M
    vector: Array  # v
    constant: float = 0.0  # c
    # relative asymmetry of the information matrix from marginalisation; None for the prior of a
    # start
    asymmetry: float | None = None

    def frames(self) -> set[int]:
        """Stamps of the frames in the prior."""
        return {key for key, _ in self.keys if isinstance(key, int)}

    def at(self, places: dict[int, int]) -> dict[str, Any]:
        """Return the prior in the core's format, for frames at given positions of the window."""
        count = len(places)
        special = {CAMERA: 2 * count, TIME: 2 * count + 1}
        blocks = [
            2 * places[key] + kind if isinstance(key, int) else special[key]
            for key, kind in self.keys
        ]
        return {
            "blocks": blocks,
            "points": self.points,
            "square_root": self.square_root,
            "matrix": self.matrix,
            "vector": self.vector,
            "constant": self.constant,
        }

    @classmethod
    def of(cls, found: dict[str, Any], stamps: list[int]) -> MarginalPrior:
        """Return the prior, zero at its minimum, from the core's result for these stamps."""
        prior = found["prior"]
        keys: list[tuple[int | str, int]] = []
        for block in prior["blocks"]:
            if block < 2 * len(stamps):
                keys.append((stamps[block // 2], block % 2))
            else:
                keys.append((CAMERA if block == 2 * len(stamps) else TIME, 0))
        return cls(
            tuple(keys),
            prior["points"],
            prior["square_root"],
            prior["matrix"],
            prior["vector"],
            prior["constant"] - found["least_cost"],
            found["asymmetry"],
        )

    def spectrum(self, scaled: bool = False) -> Array:
        """Return the ascending eigenvalues of the information, with a unit diagonal if scaled."""
        return np.asarray(_core.prior_spectrum(self.matrix, self.square_root, scaled))

    def definiteness(self) -> float:
        """Ratio of smallest and largest eigenvalue with a unit diagonal, without the gauge.

        No sensor measures the position and yaw of the whole window. The rounding errors of all
        marginalisations add up along these four directions, more the farther the platform goes,
        and an error there moves all frames alike.
        """
        if self.square_root:
            values = self.spectrum(scaled=True)
        else:
            scale, scaled = _with_unit_diagonal(self.matrix)
            gauge = self._gauge() / scale[:, None]
            rest = np.eye(len(scale)) - gauge @ np.linalg.pinv(gauge)
            values = np.linalg.eigvalsh(rest @ scaled @ rest)
        return float(values[0] / values[-1])

    def _gauge(self) -> Array:
        """(n, 4) motions of the window that no sensor measures: translations, and yaw."""
        centre = self.points[:, 4:7].mean(axis=0)
        blocks = []
        for (key, kind), point in zip(self.keys, self.points, strict=True):
            if not isinstance(key, int):
                blocks.append(np.zeros((6 if key == CAMERA else 1, 4)))
                continue
            block = np.zeros((SIZES[kind], 4))
            if kind == POSE:
                block[:3, 3] = _rotation(point)[2]
                block[3:, :3] = np.eye(3)
                block[3:, 3] = np.cross([0, 0, 1], point[4:7] - centre)
            else:
                block[:3, 3] = np.cross([0, 0, 1], point[7:10])
            blocks.append(block)
        return np.concatenate(blocks)

    def oldest_ratio(self) -> float:
        """Ratio of smallest and largest eigenvalue of the information on the first frame.

        This is the information on that frame given all others, with a unit diagonal. The IMU and
        the marginalised landmarks then determine all of its 15 coordinates, so an eigenvalue of 0
        is a loss of digits.
        """
        first = self.keys[0][0]
        count = sum(SIZES[kind] for key, kind in self.keys if key == first)
        part = self.matrix[:, :count]
        block = part.T @ part if self.square_root else part[:count]
        values = np.linalg.eigvalsh(_with_unit_diagonal(block)[1])
        return float(values[0] / values[-1])

    def relinearized(self, states: dict[int, Array]) -> MarginalPrior:
        """Return the prior about the current states with the same minimum: V <- v +- M d."""
        points, steps = self.points.copy(), []
        for row, (key, kind) in enumerate(self.keys):
            if not isinstance(key, int):
                steps.append(np.zeros(6 if key == CAMERA else 1))
                continue
            local = np.asarray(_core.state_coordinates(points[row], states[key]))
            steps.append(local[:6] if kind == POSE else local[6:])
            points[row] = states[key]
        d = np.concatenate(steps)
        moved = self.matrix @ d
        if self.square_root:
            return replace(self, points=points, vector=self.vector + moved)
        constant = self.constant + float(0.5 * d @ moved - self.vector @ d)
        return replace(self, points=points, vector=self.vector - moved, constant=constant)


def _with_unit_diagonal(matrix: Array) -> tuple[Array, Array]:
    """Return the scale of each coordinate and the scaled matrix; rows of zeros stay."""
    diagonal = np.diag(matrix)
    scale = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 1.0)
    return scale, matrix * np.outer(scale, scale)


def start_prior(
    stamps: Sequence[int],
    states: Array,
    *,
    position: float,
    yaw: float,
    gyro_bias: float,
    accel_bias: float,
    at_rest: bool,
    square_root: bool,
    camera: Array | None = None,
) -> MarginalPrior:
    """Return the prior of the first frames from sigmas of the first: m, rad, rad/s, m/s^2.

    Zero sigmas of position and yaw mean no prior on them. Yaw is a rotation about the world's z: a
    rotation d of the body changes it by (R^T e_z)^T d. At rest all velocities are zero and all
    positions equal the first, to 1 cm/s and 5 mm. Until the platform has turned, only its prior
    determines a refined camera_from_imu (7,): the given one, with sigmas of 3 degrees and 5 cm.
    """
    frames = len(stamps) if at_rest else 1
    columns = 15 * frames + (0 if camera is None else 6)
    root = [np.zeros((0, columns))]

    def add(rows: Array, *blocks: tuple[int, Array]) -> None:
        out = np.zeros((len(rows), columns))
        for column, values in blocks:
            out[:, column : column + values.shape[1]] = values
        root.append(out)

    eye = np.eye(3)
    if yaw > 0:
        add(eye[:1], (0, _rotation(states[0])[2:] / yaw))
    if position > 0:
        add(eye, (3, eye / position))
    add(eye, (9, eye / gyro_bias))
    add(eye, (12, eye / accel_bias))
    residual = [np.zeros(sum(len(rows) for rows in root))]
    for k in range(frames if at_rest else 0):
        add(eye, (15 * k + 6, eye / REST_SPEED))
        residual.append(states[k, 7:10] / REST_SPEED)
        if k:
            add(eye, (15 * k + 3, eye / REST_DISTANCE), (3, -eye / REST_DISTANCE))
            residual.append((states[k, 4:7] - states[0, 4:7]) / REST_DISTANCE)
    keys: list[tuple[int | str, int]]
    keys = [(stamp, kind) for stamp in stamps[:frames] for kind in (POSE, MOTION)]
    points = np.repeat(states[:frames], 2, axis=0)
    if camera is not None:
        add(eye, (15 * frames, eye / CAMERA_TURN))
        add(eye, (15 * frames + 3, eye / CAMERA_SHIFT))
        residual.append(np.zeros(6))
        keys.append((CAMERA, 0))
        points = np.vstack([points, np.r_[camera, np.zeros(9)]])
    rows, v = np.concatenate(root), np.concatenate(residual)
    if square_root:
        return MarginalPrior(tuple(keys), points, True, rows, v)
    constant = 0.5 * float(v @ v)
    return MarginalPrior(tuple(keys), points, False, rows.T @ rows, -rows.T @ v, constant)


def _rotation(state: Array) -> Array:
    return np.asarray(rotation_matrices(np.asarray(state)[None, :4])[0])


SLOWEST = 0.5  # m/s: a slower velocity has no reliable direction
COLUMNS = 9  # velocity and two biases


def steady_speed(
    frames: Sequence[WindowFrame], sigma: float, square_root: bool
) -> MarginalPrior | None:
    """Return a prior on the changes of speed between consecutive frames.

    ``frames``: frames in ascending time. ``sigma``: standard deviation of the mean acceleration
    along the path between two frames, m/s^2.

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
