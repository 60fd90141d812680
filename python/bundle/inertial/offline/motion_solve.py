"""Solve of a reconstruction with preintegrated motions between its images.

The cost gains, for consecutive images, the factors of ``cpp/core/factors/image_imu_factor.h`` and
random walks of the biases. Velocities and biases are three numbers each, and additional points of
the problem without observations; the result does not have them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.graphs.factors.factors import BetweenFactor, Factor, PriorFactor
from bundle.inertial.preintegration.imu_factors import ImageImuFactor
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.interface.options import SolveOptions
from bundle.interface.solve_record import Progress
from bundle.model.problem import Problem
from bundle.model.sequence.imu_noise import ImuNoise
from bundle.solving.result import Result
from bundle.solving.solve import solve

__all__ = ["GRAVITY", "MotionState", "solved_with_motions"]

Array = NDArray[np.float64]

GRAVITY = 9.81
"""Length of gravity, m/s^2."""
GYRO_BIAS_SIGMA, ACCEL_BIAS_SIGMA = 0.1, 0.3
"""Weak priors of the first biases, rad/s and m/s^2."""


class MotionState(NamedTuple):
    """Problem, and velocities (n, 3) and biases (n, 6) in the order of time."""

    problem: Problem
    velocities: Array
    biases: Array


def solved_with_motions(
    state: MotionState,
    order: NDArray[np.intp],
    motions: list[Preintegration],
    camera_from_imu: Array,
    noise: ImuNoise,
    others: Sequence[Factor],
    options: SolveOptions,
    progress: Progress | None,
) -> tuple[Result, MotionState]:
    """Solve from a state with the motions between consecutive images, and with other factors."""
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
    factors += others
    result = solve(extended, options, factors=factors, progress=progress)
    points = result.problem.points
    velocities, gyro, accel = points[problem.num_points :].reshape(3, count, 3)
    refined = result.problem.replace(
        points=points[: problem.num_points], point_ids=problem.point_ids
    )
    return result, MotionState(refined, velocities, np.hstack([gyro, accel]))


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
