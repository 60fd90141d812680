"""Bundle adjustment of a reconstruction of a video together with the samples of its IMU.

A monocular reconstruction has no scale and no vertical, and drifts along a video. The samples of an
IMU between its images determine scale and vertical, and hold the shape. The cost of a solve gains,
for consecutive images, the factors of ``cpp/core/factors/image_imu_factor.h`` and random walks of
the biases. Velocities and biases are three numbers each, and additional points of the problem
without observations; the result does not have them. The model is first brought into metres with z
up (``inertial_start``), where gravity is known; position and heading stay free.

Preintegrated motions are of first order in the biases. A second solve starts with motions that are
integrated again at the biases of the first one, if these moved far.
"""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.georeference.pose_alignment import align_centers
from bundle.georeference.similarity import Similarity, moved
from bundle.graphs.factors.factors import BetweenFactor, Factor, PriorFactor
from bundle.inertial.offline.inertial_result import ImuSamples, InertialAdjustment
from bundle.inertial.offline.inertial_start import (
    InertialStart,
    preintegrated,
    solve_inertial_start,
)
from bundle.inertial.preintegration.imu_factors import ImageImuFactor
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.inertial.vio.sequence_images import ImuSlices
from bundle.inertial.vio.window_frame import ImuInterval
from bundle.interface.option_fields import number
from bundle.interface.options import SolveOptions
from bundle.interface.solve_record import Progress
from bundle.model.problem import Problem
from bundle.model.rotations import rotation_matrices
from bundle.model.sequence.imu_noise import ImuNoise
from bundle.model.sequence.sequence import check_imu
from bundle.solving.kept_errors import Edit
from bundle.solving.result import Result
from bundle.solving.solve import solve

__all__ = ["adjust_with_imu"]

Array = NDArray[np.float64]

GRAVITY = 9.81
"""Length of gravity, m/s^2."""
NOISE_SCALE, AT_INTERVAL = 5.0, 0.25
"""Factor on the noise densities of data sheets, which do not include vibration, for images at this
interval in seconds."""
RULE = "midpoint"
GYRO_BIAS_SIGMA, ACCEL_BIAS_SIGMA = 0.1, 0.3
"""Weak priors of the first biases, rad/s and m/s^2."""
LEAST_IMAGES = 5
MOST_SCALE_SIGMA = 0.5
"""Relative standard deviation of the first scale, beyond which the motion does not determine it."""
ROUNDS = 3


def adjust_with_imu(
    problem: Problem,
    samples: ImuSamples,
    image_times_ns: NDArray[np.int64],
    camera_from_imu: Any,
    noise: ImuNoise,
    options: SolveOptions | None = None,
    *,
    imu_noise_scale: float | None = None,
    progress: Progress | None = None,
) -> InertialAdjustment:
    """Adjust a reconstruction of a video with the samples of its IMU.

    Args:
        problem: reconstruction in any frame and unit, without rigs.
        samples: samples of the IMU, on its clock.
        image_times_ns: (n,) times of the problem's images, on the same clock.
        camera_from_imu: (7,) qx qy qz qw tx ty tz in metres, the same for all images.
        noise: noise densities and random walks of the IMU.
        options: options of the solve; ``backend`` must be "auto" or "ceres", and no image is fixed.
        imu_noise_scale: factor on the two noise densities; None: 5 for images at 4 Hz, otherwise
            in proportion to the root of the time between images, and at least 1.
        progress: as for :func:`bundle.solve`.

    Raises:
        InputError: an argument is wrong, the samples do not cover the images, or the motion does
            not determine the scale.
    """
    options = _checked(problem, options)
    stamps = np.asarray(image_times_ns, np.int64)
    order = np.argsort(stamps, kind="stable")
    intervals = _intervals(samples, stamps[order])
    scale = _noise_scale(stamps[order], imu_noise_scale)
    noise = noise.scaled(scale, walks=False)
    extrinsics = np.asarray(camera_from_imu, np.float64)
    start, placed, similarity = _start(problem, order, intervals, extrinsics, noise)
    rotation = similarity.rotation
    state = _State(
        placed,
        start.velocities @ rotation.T,
        np.tile(np.append(start.gyro_bias, start.accel_bias), (len(order), 1)),
    )
    results: list[Result] = []
    for _ in range(ROUNDS):
        motions = preintegrated(intervals, noise, state.biases[:-1], RULE)
        result, state = _solved(state, order, motions, extrinsics, noise, options, progress)
        results.append(result)
        pairs = zip(motions, state.biases, strict=False)
        is_far = any(motion.needs_repropagation(bias[:3]) for motion, bias in pairs)
        if not is_far or result.summary.interrupted or not result.summary.is_solution_usable:
            break
    costs = np.asarray(results[-1].factor_costs_after)
    count = len(intervals)
    finished = dataclasses.replace(
        results[-1],
        problem=state.problem,
        initial_problem=problem,
        similarity=similarity,
        edits=(Edit("alignment", problem, placed),),
    )
    back = np.argsort(order)
    return InertialAdjustment(
        result=finished,
        similarity=similarity,
        scale=align_centers(problem.projection_centers, state.problem.projection_centers).scale,
        start=start,
        timestamps_ns=stamps,
        velocities=state.velocities[back],
        gyro_biases=state.biases[back, :3],
        accel_biases=state.biases[back, 3:],
        imu_cost=float(costs[:count].sum()),
        noise_scale=scale,
        num_solves=len(results),
    )


class _State(NamedTuple):
    """Problem, and velocities (n, 3) and biases (n, 6) in the order of time."""

    problem: Problem
    velocities: Array
    biases: Array


def _checked(problem: Problem, options: SolveOptions | None) -> SolveOptions:
    options = SolveOptions() if options is None else options
    if problem.num_frames:
        raise InputError("imu: expected images without rigs, found a model with rigs")
    if problem.num_images < LEAST_IMAGES:
        raise InputError(
            f"imu: expected at least {LEAST_IMAGES} images, found {problem.num_images}"
        )
    if options.fixed_image_ids or "poses" not in options.refine:
        raise InputError("imu: expected poses that are refined, found fixed images or poses")
    if options.fixed_point_ids:
        raise InputError("imu: expected points that are refined, found fixed points")
    if options.backend not in ("auto", "ceres"):
        raise InputError(f"imu: expected the backend auto or ceres, found {options.backend}")
    solver = options.linear_solver_type
    return options.replace(
        backend="ceres",
        gauge="none",
        linear_solver_type="sparse_schur" if solver == "auto" else solver,
    )


def _noise_scale(stamps: NDArray[np.int64], given: float | None) -> float:
    """Return the factor on the noise densities.

    The errors of a tracked point are correlated from image to image: images at a higher rate hold
    more observations, but not more information. Without a smaller noise of the IMU, they would
    outweigh it.
    """
    if given is not None:
        return number("imu_noise_scale", given, above=0)
    interval = 1e-9 * float(np.median(np.diff(stamps)))
    return max(NOISE_SCALE * math.sqrt(interval / AT_INTERVAL), 1.0)


def _intervals(samples: ImuSamples, stamps: NDArray[np.int64]) -> list[ImuInterval]:
    """Return the samples between consecutive images."""
    check_imu(*samples, lambda row: f"IMU sample {row}")
    first, last = int(samples.timestamps_ns[0]), int(samples.timestamps_ns[-1])
    outside = (stamps < first) | (stamps > last)
    if outside.any():
        found = int(stamps[np.flatnonzero(outside)[0]])
        how = "all images are" if outside.all() else f"{int(outside.sum())} images are"
        raise InputError(
            f"imu: expected images between the samples ({first} to {last} ns), found {found}: "
            f"{how} outside"
        )
    steps = np.flatnonzero(np.diff(stamps) <= 0)
    if len(steps):
        raise InputError(
            f"imu: expected images at different times, found {int(stamps[steps[0]])} ns twice"
        )
    slices = ImuSlices(samples.timestamps_ns, samples.gyro, samples.accel, RULE)
    return [slices.between(begin, end) for begin, end in pairwise(stamps.tolist())]


def _start(
    problem: Problem,
    order: NDArray[np.intp],
    intervals: list[ImuInterval],
    camera_from_imu: Array,
    noise: ImuNoise,
) -> tuple[InertialStart, Problem, Similarity]:
    """Return the start in the model's world, and the model in metres with z up."""
    rotations = rotation_matrices(problem.cam_from_world[order, :4])
    turn = rotation_matrices(camera_from_imu[None, :4])[0]
    start = solve_inertial_start(
        np.swapaxes(rotations, 1, 2) @ turn,
        problem.projection_centers[order],
        np.einsum("nji,j->ni", rotations, camera_from_imu[4:]),
        intervals,
        noise,
        GRAVITY,
        RULE,
    )
    if not (start.scale > 0 and start.scale_sigma < MOST_SCALE_SIGMA):
        raise InputError(
            "imu: expected a motion that determines the scale, found "
            f"{start.scale:.3g} +- {100 * start.scale_sigma:.2g} % m per unit: too little "
            "acceleration, or IMU, times and camera_from_imu do not belong to these images"
        )
    down = start.gravity / np.linalg.norm(start.gravity)
    level = _level(down)
    middle = problem.projection_centers.mean(axis=0)
    similarity = Similarity(start.scale, level, -start.scale * level @ middle)
    return start, moved(problem, similarity), similarity


def _level(down: Array) -> Array:
    """Return the shortest turn of a unit vector to (0, 0, -1)."""
    x, y, z = down
    if z > 1 - 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    axis = np.array([-y, x, 0.0])  # down x (0, 0, -1)
    cross = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 - z))


def _solved(
    state: _State,
    order: NDArray[np.intp],
    motions: list[Preintegration],
    camera_from_imu: Array,
    noise: ImuNoise,
    options: SolveOptions,
    progress: Progress | None,
) -> tuple[Result, _State]:
    problem, count = state.problem, len(order)
    first_id = int(problem.point_ids.max(initial=0)) + 1
    ids = first_id + np.arange(3 * count)
    added = [state.velocities, state.biases[:, :3], state.biases[:, 3:]]
    extended = problem.replace(
        points=np.concatenate([problem.points, *added]),
        point_ids=np.concatenate([problem.point_ids, ids]),
    )
    factors = _factors(
        problem.image_ids[order].tolist(),
        ids.reshape(3, count).tolist(),
        motions,
        camera_from_imu,
        noise,
    )
    result = solve(extended, options, factors=factors, progress=progress)
    points = result.problem.points
    velocities, gyro, accel = points[problem.num_points :].reshape(3, count, 3)
    refined = result.problem.replace(
        points=points[: problem.num_points], point_ids=problem.point_ids
    )
    return result, _State(refined, velocities, np.hstack([gyro, accel]))


def _factors(
    images: list[int],
    points: list[list[int]],
    motions: list[Preintegration],
    camera_from_imu: Array,
    noise: ImuNoise,
) -> list[Factor]:
    """Return the motions, then random walks and priors of the biases."""
    velocity, gyro, accel = ([("point", one) for one in part] for part in points)
    pose = [("image", image) for image in images]
    factors: list[Factor] = [
        ImageImuFactor(
            pose[k], velocity[k], gyro[k], accel[k], pose[k + 1], velocity[k + 1], motion,
            camera_from_imu, gravity=(0.0, 0.0, -GRAVITY),
        )
        for k, motion in enumerate(motions)
    ]  # fmt: skip
    for keys, walk, sigma in (
        (gyro, noise.gyro_bias_random_walk, GYRO_BIAS_SIGMA),
        (accel, noise.accel_bias_random_walk, ACCEL_BIAS_SIGMA),
    ):
        for k, motion in enumerate(motions):
            information = 1 / (walk**2 * motion.duration)
            factors.append(BetweenFactor(keys[k], keys[k + 1], np.zeros(3), information))
        factors.append(PriorFactor(keys[0], np.zeros(3), 1 / sigma**2))
    return factors
