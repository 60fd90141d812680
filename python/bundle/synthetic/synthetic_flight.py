"""Synthetic flights: a motion, its IMU and camera measurements, and ground truth.

Options and seed determine a flight. Biases are random walks: the standard deviation of their change
between samples with interval h is the density of the walk times sqrt(h). Ground truth is given at
the stamps of the images, on the IMU's clock.

Every image continues those tracks of the previous image that are still in view and have not reached
their length. It starts new tracks at random points that are not tracked. A lost point returns with
another id, as in a real tracker.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, NamedTuple, Unpack

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from bundle.interface.option_class import takes_options
from bundle.interface.scene_options import FlightOptions
from bundle.io.sequences.sequence_folder import save_sequence
from bundle.io.sequences.trajectory_files import Trajectory, save_ground_truth
from bundle.model.rigid_motions import (
    inverse_poses,
    multiply_poses,
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_rotate,
    rotation_matrices,
    vector_from_quaternion,
)
from bundle.model.sequence.calibration import Calibration, ImuNoise
from bundle.model.sequence.sequence import Sequence

if TYPE_CHECKING:
    from bundle.interface.option_keywords import FlightKeywords

# Motions of a flight: splines of position and of yaw, pitch, roll, and exact IMU samples.
#
# The body's x axis points forward, y left, z up. Its rotation is R = Rz(yaw) Ry(pitch) Rx(roll),
# with positive pitch nose down. A motion starts at rest and accelerates over some seconds, so that
# all splines are continuous.
#
# Splines are uniform B-splines of degree five. They have four continuous derivatives, which are
# computed exactly.
#
# The basis function of degree n is nonzero on [0, n + 1] and a polynomial q_k^n(u) on each [k, k +
# 1], u = t - k. The recursion of Cox and de Boor is
#
#     n q_k^n(u) = (u + k) q_k^{n-1}(u) + (n + 1 - k - u) q_{k-1}^{n-1}(u),   q_0^0 = 1.
#
# Between knots j and j + 1 the spline is sum_i q_{n-i}^n(u) c_{j+i} over the n + 1 control points
# of this interval. A control point has its largest influence (n + 1) / 2 intervals after the start
# of its support. This time is the time of the control point.
#
# IMU samples are computed from the states along the spline.
#
# With R = Rz(yaw) Ry(pitch) Rx(roll) the angular rate in the body's frame is
#
#     w = (roll' - yaw' sin pitch,
#          pitch' cos roll + yaw' sin roll cos pitch,
#          yaw' cos roll cos pitch - pitch' sin roll)
#
# and the specific force is f = R^T (p'' - g). These are the samples of kind "instant". The kind
# "interval" is a sensor that integrates over the interval h to its next sample. It measures
#
#     w_k = Log(R_k^T R_{k+1}) / h,    f_k = R_k^T ((v_{k+1} - v_k) / h - g)
#
# so that R_{k+1} = R_k Exp(w_k h) and v_{k+1} = v_k + (R_k f_k + g) h are exact.


Array = NDArray[np.float64]

DEGREE = 5
CHUNK = 100_000


def control_times(duration: float, spacing: float) -> Array:
    """Return the times of the control points of a spline over [0, duration]."""
    count = int(duration / spacing) + 1 + DEGREE
    times: Array = spacing * (np.arange(count, dtype=np.float64) - (DEGREE - 1) / 2)
    return times


def spline_at(control: Array, spacing: float, times: Array, derivative: int = 0) -> Array:
    """Return the values of a spline, or of a time derivative, at times within its duration.

    Args:
        control: (m, d) control points, at :func:`control_times`.
        spacing: seconds between knots.
        times: (n,) times in seconds.
        derivative: order of the derivative.

    Returns:
        Values (n, d).
    """
    weights = _basis(DEGREE)[::-1]  # in the order of the control points
    coefficients = np.array(
        [polynomial.polyder(row, derivative) / spacing**derivative for row in weights]
    )
    result = np.empty((len(times), control.shape[1]))
    for begin in range(0, len(times), CHUNK):
        part = slice(begin, begin + CHUNK)
        place = times[part] / spacing
        knot = np.clip(np.floor(place), 0, len(control) - DEGREE - 1).astype(np.int64)
        shares = polynomial.polyval(place - knot, coefficients.T)  # (DEGREE + 1, chunk)
        total = np.zeros((len(place), control.shape[1]))
        for i in range(DEGREE + 1):
            total += shares[i][:, None] * control[knot + i]
        result[part] = total
    return result


def _basis(degree: int) -> Array:
    """Return the coefficients of q_k, constant first, in row k: (degree + 1, degree + 1)."""
    pieces = np.ones((1, 1))
    for n in range(1, degree + 1):
        raised = np.zeros((n + 1, n + 1))
        for k in range(n):
            raised[k] += polynomial.polymul(pieces[k], [k, 1.0]) / n
            raised[k + 1] += polynomial.polymul(pieces[k], [n - k, -1.0]) / n
        pieces = raised
    return pieces


SPACING = 0.1  # s between knots
RAMP = 2.0  # s from rest to full motion
ROOM = np.array([12.0, 12.0, 5.0])  # m, centred at the origin, with the floor at 0
ROOM_POINTS = 3000
LOOP_RADIUS, LOOP_SPEED = 3.5, 1.5
MOTORWAY_SPEED, MOTORWAY_RAMP, MOTORWAY_WEAVING = 30.0, 10.0, 15.0  # m/s, s, s
ROAD_POINTS_PER_METRE = 4.0
HOVER_AFTER, HOVER_FADE, HOVER_DRIFT = 8.0, 3.0, 0.002  # s, s, remaining share


class Surroundings(NamedTuple):
    """Points (n, 3) sorted by x, and the range of distances at which the camera sees them [m]."""

    points: Array
    near: float
    far: float


def control_points(motion: str, duration: float, rest: float, rng: np.random.Generator) -> Array:
    """Return control points (m, 6): x y z [m], yaw pitch roll [rad]."""
    time = np.maximum(control_times(duration, SPACING) - rest, 0.0)
    start = np.clip(time / RAMP, 0, 1)
    start = start**2 * (3 - 2 * start)
    if motion == "loop":
        angle = _distance(time, LOOP_SPEED, RAMP) / LOOP_RADIUS
        path = np.zeros((len(time), 6))
        path[:, 0] = LOOP_RADIUS * np.cos(angle)
        path[:, 1] = LOOP_RADIUS * np.sin(angle)
        path[:, 2] = 2.0 + 0.4 * np.sin(0.6 * time) * start
        path[:, 3] = angle + np.pi / 2
        shake = _wander(time, [0.05, 0.05, 0.05, 0.05, 0.06, 0.08], 0.4, 1.0, rng)
        return path + start[:, None] * shake
    if motion == "motorway":
        path = np.zeros((len(time), 6))
        path[:, 0] = _distance(time, MOTORWAY_SPEED, MOTORWAY_RAMP)
        path[:, 2] = 1.5
        weaving = np.clip((MOTORWAY_WEAVING - time) / RAMP, 0, 1)
        weaving = start * weaving**2 * (3 - 2 * weaving)
        shake = _wander(time, [0, 0.5, 0.05, 0.03, 0.01, 0.02], 0.2, 0.7, rng)
        return path + weaving[:, None] * shake
    path = np.tile([0.0, 0.0, 2.0, 0.0, 0.0, 0.0], (len(time), 1))
    slow = _wander(time, [1.6, 1.6, 0.4, 0.8, 0.1, 0.1], 0.05, 0.25, rng)
    shake = _wander(time, [0.05, 0.05, 0.05, 0.05, 0.06, 0.08], 0.4, 1.0, rng)
    wander = start[:, None] * (slow + shake)
    if motion == "hover":
        fade = np.clip((HOVER_AFTER + HOVER_FADE - time) / HOVER_FADE, 0, 1)
        fade = fade**2 * (3 - 2 * fade)
        wander *= np.maximum(fade, HOVER_DRIFT)[:, None]
    if motion == "rotation_only":
        wander[:, :3] = 0
    return path + wander


def surroundings(motion: str, control: Array, rng: np.random.Generator) -> Surroundings:
    """Return the points around the path of a motion."""
    if motion == "motorway":
        length = control[:, 0].max() + 150.0
        count = int(length * ROAD_POINTS_PER_METRE)
        side = np.where(rng.random(count) < 0.5, -1.0, 1.0)
        points = np.column_stack(
            [
                rng.uniform(-5.0, length, count),
                side * rng.uniform(6.0, 25.0, count),
                rng.uniform(0.0, 8.0, count),
            ]
        )
        return Surroundings(points[np.argsort(points[:, 0], kind="stable")], 4.0, 80.0)
    points = rng.uniform(-0.5, 0.5, (ROOM_POINTS, 3)) * ROOM
    areas = np.array([ROOM[1] * ROOM[2], ROOM[0] * ROOM[2], ROOM[0] * ROOM[1]])
    axis = rng.choice(3, ROOM_POINTS, p=areas / areas.sum())
    rows = np.arange(ROOM_POINTS)
    points[rows, axis] = np.where(rng.random(ROOM_POINTS) < 0.5, -0.5, 0.5) * ROOM[axis]
    points[:, 2] += ROOM[2] / 2
    return Surroundings(points[np.argsort(points[:, 0], kind="stable")], 0.5, 30.0)


def _distance(time: Array, speed: float, ramp: float) -> Array:
    """Return the travelled distance; the acceleration is constant over the first `ramp` seconds."""
    result: Array = np.where(time < ramp, speed * time**2 / (2 * ramp), speed * (time - ramp / 2))
    return result


def _wander(
    time: Array, sizes: list[float], slowest: float, fastest: float, rng: np.random.Generator
) -> Array:
    """Return sums of three sine waves for each size, with frequencies in Hz between the bounds."""
    size = np.array(sizes)
    frequency = rng.uniform(slowest, fastest, (3, len(size)))
    phase = rng.uniform(0, 2 * np.pi, (3, len(size)))
    waves = np.sin(2 * np.pi * frequency * time[:, None, None] + phase)
    result: Array = size * waves.sum(axis=1) / np.sqrt(3)
    return result


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
        times: (n,) times in seconds; with "interval", the last sample repeats the previous sample.
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


CHUNK_OF_IMAGES = 64  # number of images to project at once


class Pinhole(NamedTuple):
    """Pinhole camera: focal length, principal point and size in pixels."""

    focal: float
    center: tuple[float, float]
    size: tuple[int, int]


class Tracked(NamedTuple):
    """Observations sorted by image, then id."""

    image: NDArray[np.int64]  # (m,) index of the image
    track: NDArray[np.int64]  # (m,) id of the track
    point: NDArray[np.int64]  # (m,) index of the point
    xy: Array  # (m, 2) pixels without noise


def follow(
    poses: Array,
    camera_from_imu: Array,
    lens: Pinhole,
    around: Surroundings,
    num_tracks: int,
    track_length: float,
    rng: np.random.Generator,
) -> Tracked:
    """Return the tracks along poses (n, 7), world_from_imu.

    Args:
        camera_from_imu: (7,) pose.
        around: points in the world.
        num_tracks: wanted number of tracks per image.
    """
    mount = np.tile(camera_from_imu, (len(poses), 1))
    cameras = multiply_poses(mount, inverse_poses(poses))
    turns, shifts = rotation_matrices(cameras[:, :4]), cameras[:, 4:]
    x = around.points[:, 0]
    ids = points = left = np.zeros(0, np.int64)  # active tracks
    next_id = 0
    parts: list[tuple[NDArray[np.int64], ...]] = []
    coordinates: list[Array] = []
    for begin in range(0, len(poses), CHUNK_OF_IMAGES):
        chunk = slice(begin, min(begin + CHUNK_OF_IMAGES, len(poses)))
        ahead = poses[chunk, 4]
        low = int(np.searchsorted(x, ahead.min() - around.far))
        near = around.points[low : int(np.searchsorted(x, ahead.max() + around.far))]
        local = np.einsum("fij,pj->fpi", turns[chunk], near) + shifts[chunk][:, None]
        depth = np.maximum(local[..., 2:], 1e-9)
        pixels = lens.focal * local[..., :2] / depth + np.array(lens.center)
        inside = (pixels >= 0) & (pixels < np.array(lens.size))
        seen = inside.all(axis=2) & (local[..., 2] > around.near) & (local[..., 2] < around.far)
        for row, visible in enumerate(seen):
            place = points - low
            known = (place >= 0) & (place < len(near)) & (left > 0)
            known[known] = visible[place[known]]
            ids, points, left = ids[known], points[known], left[known] - 1
            wanted = num_tracks - len(ids)
            if wanted > 0:
                free = visible.copy()
                free[points - low] = False
                fresh = rng.permutation(np.flatnonzero(free))[:wanted]
                ids = np.append(ids, next_id + np.arange(len(fresh)))
                points = np.append(points, fresh + low)
                left = np.append(left, rng.geometric(1 / track_length, len(fresh)) - 1)
                next_id += len(fresh)
            parts.append((np.full(len(ids), begin + row), ids, points))
            coordinates.append(pixels[row, points - low])
    image, track, point = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Tracked(image, track, point, np.concatenate(coordinates))


START = 1_700_000_000_000_000_000  # ns
LENS = Pinhole(focal=460.0, center=(376.0, 240.0), size=(752, 480))
# The camera looks forward (its z along the body's x), 5 cm in front of the IMU and 3 cm to the
# left.
IMU_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
CAMERA_IN_IMU = np.array([0.05, 0.03, 0.01])
DENSITIES = np.array([1.6968e-4, 2.0e-3, 1.9393e-5, 3.0e-3])  # ADIS16448, EuRoC's sensor.yaml
GROUND_TRUTH = "ground_truth.csv"


class SyntheticFlight(NamedTuple):
    """Measurements of a flight, and the true states at the stamps of its images."""

    sequence: Sequence
    ground_truth: Trajectory


@takes_options(FlightOptions)
def synthesize_flight(
    options: FlightOptions | None = None, **changes: Unpack[FlightKeywords]
) -> SyntheticFlight:
    """Make a visual-inertial sequence with ground truth.

    Args:
        options: options of the flight; None: the defaults.
        **changes: fields of :class:`FlightOptions`, such as ``motion="motorway"``.

    Raises:
        InputError: an option is unknown or out of range, or no point is in view.
    """
    options = FlightOptions.of(options, changes, "synthesize_flight")
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(options.seed).spawn(4)]
    control = control_points(options.motion, options.duration, options.rest, streams[0])
    stamps = _stamps(options.duration, options.imu_rate)
    images = _stamps(options.duration, options.camera_rate)
    gyro, accel, biases = _measured(control, stamps, options, streams[1])

    states = np.empty((len(images), 16))
    states[:, :10] = motion_at(control, _seconds(images))
    for column in range(6):
        states[:, 10 + column] = np.interp(images, stamps, biases[:, column])
    rotation = quaternion_from_matrix(IMU_FROM_CAMERA[None])
    camera_from_imu = inverse_poses(np.hstack([rotation, CAMERA_IN_IMU[None]]))[0]
    tracked = follow(
        states[:, :7],
        camera_from_imu,
        LENS,
        surroundings(options.motion, control, streams[2]),
        options.num_tracks,
        options.track_length,
        streams[2],
    )
    offset = round(1e9 * options.time_offset)
    sequence = Sequence(
        imu_timestamps_ns=START + stamps,
        gyro=gyro,
        accel=accel,
        track_timestamps_ns=START + images[tracked.image] - offset,
        track_ids=tracked.track,
        xy=_noisy(tracked, options, streams[3]),
        calibration=Calibration(
            camera_from_imu=tuple(camera_from_imu.tolist()),
            noise=ImuNoise(*(DENSITIES * (options.imu_noise_scale or 1.0)).tolist()),
            camera_model="PINHOLE",
            camera_params=(LENS.focal, LENS.focal, *LENS.center),
            imu_rate=options.imu_rate,
            camera_rate=options.camera_rate,
            time_offset=options.time_offset,
            pixel_sigma=options.pixel_noise or 1.0,
        ),
    )
    return SyntheticFlight(sequence, Trajectory(START + images, states))


def save_flight(flight: SyntheticFlight, path: str | os.PathLike[str]) -> None:
    """Write a flight as a sequence folder, with ground truth as EuRoC's ``ground_truth.csv``."""
    save_sequence(flight.sequence, path)
    truth = flight.ground_truth
    save_ground_truth(
        os.path.join(os.fspath(path), GROUND_TRUTH),  # noqa: PTH118 (bytes are refused above)
        truth.timestamps_ns,
        truth.states,
    )


def _stamps(duration: float, rate: float) -> NDArray[np.int64]:
    """Return the stamps in ns from 0 to the duration, both ends included."""
    count = int(np.floor(duration * rate + 1e-9)) + 1
    stamps: NDArray[np.int64] = np.rint(np.arange(count) * (1e9 / rate)).astype(np.int64)
    return stamps


def _seconds(stamps: NDArray[np.int64]) -> Array:
    return stamps.astype(np.float64) * 1e-9


def _measured(
    control: Array, stamps: NDArray[np.int64], options: FlightOptions, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return noisy rates and specific forces, and biases (n, 6)."""
    count, step = len(stamps), 1 / options.imu_rate
    noise = options.imu_noise_scale * DENSITIES
    first = rng.normal(size=6) * np.repeat([options.gyro_bias, options.accel_bias], 3)
    walk = rng.normal(size=(count - 1, 6)) * np.repeat(noise[2:], 3) * np.sqrt(step)
    biases = first + np.vstack([np.zeros(6), np.cumsum(walk, axis=0)])
    white = rng.normal(size=(count, 6)) * np.repeat(noise[:2], 3) / np.sqrt(step)
    gyro, accel = imu_samples(control, _seconds(stamps), options.imu_samples)
    gyro += biases[:, :3] + white[:, :3]
    accel += biases[:, 3:] + white[:, 3:]
    return gyro, accel, biases


def _noisy(tracked: Tracked, options: FlightOptions, rng: np.random.Generator) -> Array:
    xy = tracked.xy + rng.normal(0, 1, tracked.xy.shape) * options.pixel_noise
    if options.outlier_share:
        wrong = rng.random(len(xy)) < options.outlier_share
        xy[wrong] = rng.uniform(0, LENS.size, (int(wrong.sum()), 2))
    return xy
