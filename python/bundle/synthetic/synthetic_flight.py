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
from typing import NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from bundle.interface.option_class import takes_options
from bundle.interface.option_keywords import FlightKeywords
from bundle.interface.scene_options import FlightOptions
from bundle.io.sequences.sequence_folder import save_sequence
from bundle.io.sequences.trajectory_files import Trajectory, save_ground_truth
from bundle.model.rigid_motions import (
    inverse_poses,
    multiply_poses,
    quaternion_from_matrix,
    rotation_matrices,
)
from bundle.model.sequence.calibration import Calibration, ImuNoise
from bundle.model.sequence.sequence import Sequence
from bundle.synthetic.flight_motions import (
    Surroundings,
    control_points,
    imu_samples,
    motion_at,
    surroundings,
)

Array = NDArray[np.float64]

CHUNK = 64  # number of images to project at once


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
    for begin in range(0, len(poses), CHUNK):
        chunk = slice(begin, min(begin + CHUNK, len(poses)))
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
    """Return stamps in ns from 0; their number is one more than the periods in the duration."""
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
