"""Scale, gravity, velocities and biases of images with IMU samples, and their placement.

With the bias b of the gyroscope, the preintegrated rotations dR_k(b) equal those of the images:

    Log(dR_k(b)^T R_k^T R_{k+1}) = 0,        R = world_from_imu,

by Gauss-Newton steps over all intervals, with Cauchy weights. The rotations of the images do not
drift, so that the specific force, turned by them, is integrated twice over segments of some
seconds. With c_k the projection centre in units of the model, s their length in metres, l_k the arm
from the camera to the IMU in the world, t the time since the begin of the segment, and P_k, V_k the
integrals of the turned force, Q_k and W_k their derivatives w.r.t. the accelerometer's bias a,

    s c_k + l_k = p_0 + v_0 t + 1/2 g t^2 + P_k + Q_k a,        v_k = v_0 + g t + V_k + W_k a.

The first equation is linear in s, g, a and the p_0 and v_0 of every segment, which are eliminated
from each segment by a QR factorisation. Short segments cannot separate a from g, so a prior keeps a
near 0. Then g is moved on its sphere by two coordinates (Mur-Artal and Tardos, "Visual-inertial
monocular SLAM with map reuse", 2017, solve for the same unknowns from three consecutive images at a
time, which amplifies the noise of the images).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.georeference.measurements import FoundPriors, find_priors
from bundle.georeference.pose_alignment import align_centers
from bundle.georeference.prior_alignment import survey_points
from bundle.georeference.similarity import Similarity
from bundle.georeference.similarity_fit import Correspondences
from bundle.inertial.offline.motion_solve import GRAVITY, ImuBodies
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.model.problem import Problem
from bundle.model.rigid_motions import quaternion_from_matrix, vector_from_quaternion
from bundle.model.sequence.calibration import ImuNoise

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior

Array = NDArray[np.float64]

SEGMENT = 4.0  # least duration of a segment in seconds
LEAST_IMAGES = 5  # least number of images of a segment: six numbers are its own
ACCEL_BIAS_SIGMA = 0.2  # standard deviation of the prior on the accelerometer's bias, m/s^2
POSITION_SIGMA = 0.02  # assumed standard deviation of a position over a segment, m; for the prior
STEPS, SPHERE_STEPS = 8, 6


class InertialStart(NamedTuple):
    """Start in the world of the model."""

    scale: float  # metres per unit of the model
    scale_sigma: float  # relative standard deviation of the scale, from the residuals
    gravity: Array  # (3,) m/s^2, of the given length
    gyro_bias: Array  # (3,) rad/s
    accel_bias: Array  # (3,) m/s^2
    velocities: Array  # (n, 3) of the IMU at the images, along the axes of the model, m/s
    rms: float  # root mean square of the residuals of positions in metres


class _Rows(NamedTuple):
    """Equations of a segment without its own unknowns; columns: s, g (3), a (3), right side."""

    rows: Array
    first: int
    own: Array
    shared: Array
    known: Array


def preintegrated(
    intervals: list[ImuInterval], noise: ImuNoise, biases: Array, rule: str
) -> list[Preintegration]:
    """Return the intervals preintegrated at (n, 6) biases, or at one row for all."""
    rows = np.broadcast_to(biases, (len(intervals), 6))
    states = np.concatenate([np.zeros((len(rows), 10)), rows], axis=1)
    return [
        interval.integrated(noise, state, rule)
        for interval, state in zip(intervals, states, strict=True)
    ]


def solve_inertial_start(
    rotations: Array,
    centers: Array,
    arms: Array,
    intervals: list[ImuInterval],
    noise: ImuNoise,
    gravity: float,
    rule: str,
    rate_bias: Array | None = None,
) -> InertialStart:
    """Return the start of n images.

    ``rotations`` (n, 3, 3) are world_from_imu, ``centers`` (n, 3) projection centres in units of
    the model, ``arms`` (n, 3) from camera to IMU along its axes, metres; ``gravity`` is
    a length, m/s^2. ``rate_bias``: bias of the gyroscope; None: estimated from the rotations.
    """
    if rate_bias is None:
        between = np.swapaxes(rotations[:-1], 1, 2) @ rotations[1:]
        rate_bias = gyro_bias(between, intervals, noise, rule)
    motions = preintegrated(intervals, noise, np.append(rate_bias, np.zeros(3)), rule)
    times = np.cumsum([0.0, *(motion.duration for motion in motions)])
    parts = segments(times)
    found = [segment_rows(part, rotations, centers, arms, motions, times) for part in parts]
    prior = np.zeros((3, 8))
    prior[:, 4:7] = np.eye(3) * POSITION_SIGMA / ACCEL_BIAS_SIGMA
    system = np.vstack([*(segment.rows for segment in found), prior])
    x = np.linalg.lstsq(system[:, :7], system[:, 7], rcond=None)[0]
    direction = x[1:4] / np.linalg.norm(x[1:4])
    for _ in range(SPHERE_STEPS):  # g = length (direction + basis y), then normalised
        basis = np.linalg.svd(direction[None])[2][1:].T
        reduced = np.column_stack([system[:, 0], gravity * system[:, 1:4] @ basis, system[:, 4:7]])
        right = system[:, 7] - gravity * system[:, 1:4] @ direction
        y = np.linalg.lstsq(reduced, right, rcond=None)[0]
        direction = direction + basis @ y[1:3]
        direction /= np.linalg.norm(direction)
    x = np.concatenate([y[:1], gravity * direction, y[3:]])
    residual = reduced @ y - right
    rms = float(np.sqrt((residual**2).mean()))
    covariance = np.linalg.pinv(reduced.T @ reduced) * max(rms, 1e-9) ** 2
    velocities = np.empty_like(centers)
    for part, segment in zip(parts, found, strict=True):
        left = segment.known - segment.shared @ x
        own: Any = np.linalg.lstsq(segment.own, left, rcond=None)[0]
        _, _, v, w = _integrals(part, rotations, motions)
        t = times[part[0] : part[-1] + 1] - times[part[0]]
        velocities[part[0] : part[-1] + 1] = own[3:] + np.outer(t, x[1:4]) + v + w @ x[4:7]
    return InertialStart(
        scale=float(x[0]),
        scale_sigma=float(np.sqrt(covariance[0, 0]) / abs(x[0])) if x[0] != 0 else np.inf,
        gravity=x[1:4],
        gyro_bias=rate_bias,
        accel_bias=x[4:7],
        velocities=velocities,
        rms=rms,
    )


def gyro_bias(between: Array, intervals: list[ImuInterval], noise: ImuNoise, rule: str) -> Array:
    """Return the bias for which preintegrated rotations are those between images (n - 1, 3, 3)."""
    bias = np.zeros(3)
    for _ in range(STEPS):
        motions = preintegrated(intervals, noise, np.append(bias, np.zeros(3)), rule)
        deltas = np.array([motion.delta_rotation for motion in motions])
        errors = vector_from_quaternion(quaternion_from_matrix(np.swapaxes(deltas, 1, 2) @ between))
        # Log(dR(b + d)^T B) = e - J d to first order, with J the derivative of dR at small e.
        jacobians = np.array([motion.d_rotation_d_gyro_bias for motion in motions])
        lengths = np.linalg.norm(errors, axis=1)
        weights = 1 / (1 + (lengths / (2 * np.median(lengths) + 1e-12)) ** 2)
        normal = np.einsum("n,nji,njk->ik", weights, jacobians, jacobians)
        step = np.linalg.solve(normal, np.einsum("n,nji,nj->i", weights, jacobians, errors))
        bias = bias + step
        if np.linalg.norm(step) < 1e-10:
            break
    return bias


def segments(times: Array) -> list[range]:
    """Return ranges of images; consecutive ranges share an image."""
    parts, first = [], 0
    for k in range(1, len(times)):
        if times[k] - times[first] >= SEGMENT and k - first + 1 >= LEAST_IMAGES:
            parts.append(range(first, k + 1))
            first = k
    if not parts:
        return [range(len(times))]
    if first < len(times) - 1:  # the rest belongs to the last segment
        parts[-1] = range(parts[-1][0], len(times))
    return parts


def _integrals(
    part: range, rotations: Array, motions: list[Preintegration]
) -> tuple[Array, Array, Array, Array]:
    """Return P, Q, V, W of the images of a segment."""
    n = len(part)
    p, v = np.zeros((n, 3)), np.zeros((n, 3))
    q, w = np.zeros((n, 3, 3)), np.zeros((n, 3, 3))
    for k, (image, _) in enumerate(pairwise(part)):
        motion, turn = motions[image], rotations[image]
        p[k + 1] = p[k] + v[k] * motion.duration + turn @ motion.delta_position
        q[k + 1] = q[k] + w[k] * motion.duration + turn @ motion.d_position_d_accel_bias
        v[k + 1] = v[k] + turn @ motion.delta_velocity
        w[k + 1] = w[k] + turn @ motion.d_velocity_d_accel_bias
    return p, q, v, w


def segment_rows(
    part: range,
    rotations: Array,
    centers: Array,
    arms: Array,
    motions: list[Preintegration],
    times: Array,
) -> _Rows:
    """Return the equations of a segment, three for each of its images."""
    p, q, _, _ = _integrals(part, rotations, motions)
    rows = slice(part[0], part[-1] + 1)
    t = times[rows] - times[part[0]]
    n = len(t)
    shared, own = np.zeros((n, 3, 7)), np.zeros((n, 3, 6))
    middle = centers[rows].mean(axis=0)
    shared[:, :, 0] = centers[rows] - middle  # the mean is part of p_0
    shared[:, :, 1:4] = -0.5 * t[:, None, None] ** 2 * np.eye(3)
    shared[:, :, 4:7] = -q
    own[:, :, :3], own[:, :, 3:] = -np.eye(3), -t[:, None, None] * np.eye(3)
    known = (p - arms[rows]).reshape(-1)
    by_own, by_shared = own.reshape(-1, 6), shared.reshape(-1, 7)
    basis = np.linalg.qr(by_own)[0]
    stacked = np.column_stack([by_shared, known])
    projected = stacked - basis @ (basis.T @ stacked)
    return _Rows(projected, part[0], by_own, by_shared, known)


# Placement of a reconstruction with an IMU: metres, z up, then heading and shift of its priors.
#
# Scale and gravity are those above; the smallest rotation turns the world to z up.
# Measured positions and control points then give heading and shift. Without these, priors of
# attitudes give the heading: with Q their turn of the world and L the shortest turn of Q's vertical
# back to z up, L Q is a turn about z. The minimum of the adjustment does not depend on this start.

LEAST_POSITIONS = 2
MOST_SCALE_SIGMA = 0.5  # relative sigma of the first scale, up to which the motion determines it
MOST_METRIC_SCALE = 2.0  # factor of a first scale within which a rig may be in metres: it is rough


def upright_start(
    problem: Problem,
    bodies: ImuBodies,
    intervals: list[ImuInterval],
    noise: ImuNoise,
    rule: str,
    *,
    is_metric: bool,
) -> tuple[InertialStart, Similarity]:
    """Return the start in the model's world, and the similarity to metres with z up.

    ``problem``: problem in any frame and unit. ``is_metric``: True for a constant baseline between
    sensors of a rig, which is in metres; the similarity then has scale 1.
    """
    start = solve_inertial_start(
        bodies.imu_rotations(problem), bodies.centers(problem), bodies.arms(problem),
        intervals, noise, GRAVITY, rule,
    )  # fmt: skip
    if not (start.scale > 0 and start.scale_sigma < MOST_SCALE_SIGMA):
        raise InputError(
            "imu: expected a motion that determines the scale, found "
            f"{start.scale:.3g} +- {100 * start.scale_sigma:.2g} % m per unit: too little "
            "acceleration, or IMU, times and camera_from_imu do not belong to these images"
        )
    if is_metric and not 1 / MOST_METRIC_SCALE < start.scale < MOST_METRIC_SCALE:
        raise InputError(
            f"imu: expected a rig with constant sensors to have metres as its unit, found "
            f"{start.scale:.3g} m per unit; scale the model, or refine sensor-from-rig"
        )
    scale = 1.0 if is_metric else start.scale
    level = _level(start.gravity / np.linalg.norm(start.gravity))
    middle = problem.projection_centers.mean(axis=0)
    return start, Similarity(scale, level, -scale * level @ middle)


def to_priors(problem: Problem, priors: Sequence[Prior]) -> Similarity | None:
    """Return the heading and shift that move a levelled problem in metres to its priors.

    None without priors.
    """
    if not priors:
        return None
    groups = find_priors(problem, priors)
    if points := survey_points(problem, groups):
        return _to_positions(points)
    turning = next((one for one in groups if one.moves), None)
    return None if turning is None else _to_headings(problem, turning)


def _to_positions(points: Correspondences) -> Similarity:
    has_height = ~np.isnan(points.target[:, 2])
    if has_height.sum() < LEAST_POSITIONS:
        raise InputError(
            f"imu: expected at least {LEAST_POSITIONS} positions with a height, found "
            f"{int(has_height.sum())}"
        )
    places = points.source + points.offset
    return align_centers(places[has_height], points.target[has_height], "yaw")


def _to_headings(problem: Problem, attitudes: FoundPriors) -> Similarity | None:
    found = attitudes.placement(problem)
    if found is None:
        return None
    turn = _level(-found.rotation[:, 2]) @ found.rotation
    middle = problem.projection_centers.mean(axis=0)
    return Similarity(1.0, turn, middle - turn @ middle)


def _level(down: Array) -> Array:
    """Return the shortest turn of a unit vector to (0, 0, -1)."""
    x, y, z = down
    if z > 1 - 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    axis = np.array([-y, x, 0.0])  # down x (0, 0, -1)
    cross = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 - z))
