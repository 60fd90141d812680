"""Linear start in motion: velocity, gravity and depths by linear least squares.

In the IMU frame of the first image, the motion after t seconds is, with the preintegrated dR, dp
for the gyroscope bias b (on which rotations depend alone) and J = d dp / d accelerometer bias a,

    R = dR(b),    p = v t + 1/2 g t^2 + dp(b) + J a.

A camera (R_c, t_c of camera_from_imu) observes a point X at y = R_c R^T (X - p) + t_c. Its
observation (u, w) gives y_x - u y_z = 0 and y_y - w y_z = 0, which is linear in X, v, g and a. One
linear system thus determines all unknowns except b, in metres. A vision-only reconstruction with a
scale fitted afterwards is not needed (Dong-Si and Mourikis, IROS 2012; Martinelli, IJCV 2014).

* Points are eliminated (Schur complement). Gravity has its known length and moves on its sphere by
  two coordinates, in a few iterations. A prior constrains a, which a second of motion
  determines poorly.
* The first system has the observed coordinates in its rows. The next ones are linearised at the
  previous solution, so that their errors are in pixels; the last ones have Cauchy weights.
* The initial b makes rays coplanar. For a pair of images with the right rotation, the normals of
  the planes through corresponding rays are perpendicular to the baseline (Kneip, Siegwart and
  Pollefeys, ECCV 2012). Gauss-Newton steps then refine b on the errors that the linear system
  leaves (variable projection). Derivatives are numerical: three columns.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.rigid_motions import cross_rows, rotation_matrices
from bundle.model.sequence.calibration import ImuNoise

Array = np.ndarray[Any, Any]

PLAIN_ROUNDS, ROUNDS, SPHERE_STEPS, COPLANAR_STEPS = 4, 12, 3, 6
PAIR_GAPS = (2, 4)  # number of images between a pair
LEAST_COMMON = 8  # common rays of a pair, for five unknowns
STEP = 1e-5  # rad/s, for numerical derivatives
ACCEL_BIAS_SIGMA = 0.1  # m/s^2
FAR = 1e-12  # added to a point's information, so that a point without parallax stays finite
NEAREST = 0.1  # m: depth below which the weight of rows stops growing


class Observations(NamedTuple):
    """Observations sorted by point: point, image, and normalised coordinates (n, 2)."""

    point: Array
    image: Array
    xy: Array


class LinearStart(NamedTuple):
    """Result in the IMU frame of the first image."""

    gyro_bias: Array  # (3,) rad/s
    accel_bias: Array  # (3,) m/s^2
    velocity: Array  # (3,) m/s
    gravity: Array  # (3,) m/s^2
    rotations: Array  # (k, 3, 3), motion of the images
    positions: Array  # (k, 3)
    velocities: Array  # (k, 3)
    points: Array  # (m, 3)
    depths: Array  # (n,) depth of each observation [m]
    predicted: Array  # (n, 2) normalised coordinates
    residuals: Array  # (n, 2) in sigmas, of the last linearisation, weighted
    gravity_sigma: float  # standard deviation of the direction of gravity [rad]
    scale_sigma: float  # relative sigma of the distance from the first image to the last


class _Motion(NamedTuple):
    """Preintegrated motion from the first image to each image: (k, ...)."""

    time: Array
    rotation: Array
    velocity: Array
    position: Array
    velocity_by_bias: Array
    position_by_bias: Array


def solve_linear_start(
    intervals: list[ImuInterval],
    seen: Observations,
    camera_from_imu: Array,
    noise: ImuNoise,
    sigma: float,
    gyro_bias: Array,
    gravity: float,
    rule: str,
) -> LinearStart:
    """Find the start of k images.

    ``intervals`` are the k - 1 between them; each point of ``seen`` is in at least two. ``sigma``
    is in normalised coordinates, ``gyro_bias`` an initial value, ``gravity`` a length [m/s^2].
    """
    system = _System(intervals, seen, camera_from_imu, noise, sigma, gravity, rule)
    bias = system.coplanar_bias(np.array(gyro_bias, dtype=np.float64))
    found = system.solve(bias)
    for turn in range(ROUNDS):
        system.weigh(found, turn >= PLAIN_ROUNDS)
        found = system.solve(bias)
        if turn < PLAIN_ROUNDS:
            continue
        left = found.residuals.ravel()
        columns = [
            (system.solve(bias + step).residuals.ravel() - left) / STEP for step in STEP * np.eye(3)
        ]
        bias = bias + np.linalg.lstsq(np.column_stack(columns), -left, rcond=None)[0]
        found = system.solve(bias)
    return found


class _System:
    """Linear system and its weights."""

    def __init__(
        self,
        intervals: list[ImuInterval],
        seen: Observations,
        camera_from_imu: Array,
        noise: ImuNoise,
        sigma: float,
        gravity: float,
        rule: str,
    ) -> None:
        self.intervals, self.seen, self.noise, self.rule = intervals, seen, noise, rule
        self.turn = rotation_matrices(camera_from_imu[None, :4])[0]
        self.shift = camera_from_imu[4:]
        self.sigma, self.length = sigma, gravity
        self.begin = np.flatnonzero(np.diff(seen.point, prepend=-1))
        self.depth = np.ones(len(seen.point))
        self.line = seen.xy  # coordinates from which the rows are built
        self.robust = np.ones(len(seen.point))

    def weigh(self, found: LinearStart, is_robust: bool) -> None:
        """Linearise reprojection errors at a solution, with or without Cauchy weights."""
        before = found.depths > NEAREST
        self.depth = np.where(before, found.depths, NEAREST)
        self.line = np.where(before[:, None], found.predicted, self.seen.xy)
        if is_robust:
            errors = (found.predicted - self.seen.xy) / self.sigma
            self.robust = 1 / (1 + np.sum(errors**2, axis=1))

    def solve(self, gyro_bias: Array) -> LinearStart:
        """Return the optimum of all other unknowns for a given bias."""
        motion = self._motion(gyro_bias)
        seen, t = self.seen, motion.time
        # from the first image to the camera of each image
        back = self.turn @ motion.rotation.transpose(0, 2, 1)
        rows = back[seen.image, :2] - self.line[:, :, None] * back[seen.image, 2:]
        offset = self.shift[:2] - self.line * self.shift[2]
        offset -= self.depth[:, None] * (seen.xy - self.line)
        weight = (np.sqrt(self.robust) / (self.depth * self.sigma))[:, None]
        a = rows * weight[..., None]
        # Unknowns are velocity, gravity over its length, and accelerometer bias: (k, 3, 9).
        times = t[:, None, None] * np.eye(3)
        falls = 0.5 * self.length * t[:, None, None] * times
        columns = np.concatenate([times, falls, motion.position_by_bias], axis=2)
        b = np.einsum("nij,nj->ni", a, motion.position[seen.image]) - weight * offset
        c = -a @ columns[seen.image]
        information, vector, solved = self._reduced(a, c, b)
        # The mean specific force is -g up to the change of velocity.
        direction = -motion.velocity[-1] / np.linalg.norm(motion.velocity[-1])
        basis = np.zeros((9, 8))
        basis[:3, :3] = basis[6:, 5:] = np.eye(3)
        for _ in range(SPHERE_STEPS):
            basis[3:6, 3:5] = np.linalg.svd(direction[None])[2][1:].T
            at = np.pad(direction, 3)
            covariance = np.linalg.pinv(basis.T @ information @ basis, hermitian=True)
            x = at + basis @ (covariance @ basis.T @ (vector - information @ at))
            direction = x[3:6] / np.linalg.norm(x[3:6])
        gravity, bias = self.length * direction, x[6:]
        points = solved[..., 9] - solved[..., :9] @ x
        positions = motion.position + columns @ x
        residuals = np.einsum("nij,nj->ni", a, points[seen.point]) + c @ x - b
        away = points[seen.point] - positions[seen.image]
        local = np.einsum("nij,nj->ni", back[seen.image], away) + self.shift
        velocities = x[:3] + t[:, None] * gravity + motion.velocity + motion.velocity_by_bias @ bias
        way = float(np.linalg.norm(positions[-1] - positions[0]))
        end = columns[-1] @ basis
        spread = float(np.sqrt(np.trace(end @ covariance @ end.T)))
        return LinearStart(
            gyro_bias=gyro_bias.copy(),
            accel_bias=bias,
            velocity=x[:3],
            gravity=gravity,
            rotations=motion.rotation,
            positions=positions,
            velocities=velocities,
            points=points,
            depths=local[:, 2],
            predicted=local[:, :2] / np.where(np.abs(local[:, 2:]) > 1e-9, local[:, 2:], 1e-9),
            residuals=residuals,
            gravity_sigma=float(np.sqrt(np.trace(covariance[3:5, 3:5]))),
            scale_sigma=spread / way if way > 0 else float("inf"),
        )

    def coplanar_bias(self, bias: Array) -> Array:
        """Return the bias whose rotations make the rays of each image pair coplanar."""
        seen, count = self.seen, len(self.intervals) + 1
        rays = np.column_stack([seen.xy, np.ones(len(seen.xy))]) @ self.turn  # in the IMU frame
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        row = np.full((seen.point[-1] + 1, count), -1)
        row[seen.point, seen.image] = np.arange(len(seen.point))
        pairs = []
        for gap in PAIR_GAPS:
            for i in range(count - gap):
                both = np.flatnonzero((row[:, i] >= 0) & (row[:, i + gap] >= 0))
                if len(both) >= LEAST_COMMON:
                    pairs.append((i, i + gap, rays[row[both, i]], rays[row[both, i + gap]]))

        def errors(value: Array) -> Array:
            turns = self._motion(value).rotation
            parts = []
            for i, j, first, second in pairs:
                normals = cross_rows(first @ turns[i].T, second @ turns[j].T)
                way = np.linalg.eigh(normals.T @ normals)[1][:, 0]
                error = normals @ (way if way[np.argmax(np.abs(way))] > 0 else -way)
                parts.append(error / np.sqrt(1 + (error / (2 * self.sigma)) ** 2))
            return np.concatenate(parts)

        for _ in range(COPLANAR_STEPS if pairs else 0):
            left = errors(bias)
            columns = [(errors(bias + step) - left) / STEP for step in STEP * np.eye(3)]
            bias = bias + np.linalg.lstsq(np.column_stack(columns), -left, rcond=None)[0]
        return bias

    def _reduced(self, a: Array, c: Array, b: Array) -> tuple[Array, Array, Array]:
        """Return information (9, 9), right side (9,), and s (m, 3, 10): points are s [-x, 1]."""

        def by_point(values: Array) -> Array:
            return np.add.reduceat(values, self.begin, axis=0)

        transposed = a.transpose(0, 2, 1)
        h = by_point(transposed @ a)
        h += FAR * np.trace(h, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        coupling = by_point(transposed @ c)
        right = by_point((transposed @ b[..., None])[..., 0])
        solved = np.linalg.solve(h, np.concatenate([coupling, right[..., None]], axis=2))
        information = np.einsum("nij,nik->jk", c, c)
        information -= np.einsum("mij,mik->jk", coupling, solved[..., :9])
        information = (information + information.T) / 2
        information[6:, 6:] += np.eye(3) / ACCEL_BIAS_SIGMA**2
        vector = np.einsum("nij,ni->j", c, b) - np.einsum("mij,mi->j", coupling, solved[..., 9])
        return information, vector, solved

    def _motion(self, gyro_bias: Array) -> _Motion:
        total = Preintegration(self.noise, gyro_bias, rule=self.rule)
        zero = np.zeros(3)
        start = (0.0, np.eye(3), zero, zero, np.zeros((3, 3)), np.zeros((3, 3)))
        rows: list[tuple[Any, ...]] = [start]
        for interval in self.intervals:
            total.integrate(interval.gyro, interval.accel, interval.dt)
            rows.append(
                (
                    total.duration,
                    total.delta_rotation,
                    total.delta_velocity,
                    total.delta_position,
                    total.d_velocity_d_accel_bias,
                    total.d_position_d_accel_bias,
                )
            )
        return _Motion(*(np.array(column) for column in zip(*rows, strict=True)))
