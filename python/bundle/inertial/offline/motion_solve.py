"""Solve of a reconstruction with preintegrated motions between its images.

The cost gains, for consecutive images, the factors of ``cpp/core/factors/image_imu_factor.h`` and
random walks of the biases. Velocities and biases are three numbers each, and additional points of
the problem without observations; the result does not have them. A filter between adjustments (see
:func:`bundle.solve_rounds`) keeps them, because factors name them.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.graphs.factors.factors import BetweenFactor, Factor, PriorFactor
from bundle.inertial.offline.imu_bodies import ImuBodies
from bundle.inertial.preintegration.imu_factors import ImageImuFactor
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import RoundOptions
from bundle.interface.solve_record import Progress
from bundle.model.problem import Problem
from bundle.model.sequence.calibration import ImuNoise
from bundle.solving.result import Result
from bundle.solving.rounds.solve_rounds import solve_rounds

if TYPE_CHECKING:
    from bundle.solving.placed_problem import Prior

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
    bodies: ImuBodies,
    motions: list[Preintegration],
    noise: ImuNoise,
    priors: tuple[Prior, ...],
    options: SolveOptions,
    rounds: RoundOptions,
    progress: Progress | None,
) -> tuple[Result, MotionState]:
    """Solve from a state with the motions between consecutive bodies, and with priors.

    The result has no points of motions, neither in its problem nor in the counts of its rounds.
    """
    problem, count = state.problem, len(bodies)
    first_id = int(problem.point_ids.max(initial=0)) + 1
    ids = first_id + np.arange(3 * count)
    added = [state.velocities, state.biases[:, :3], state.biases[:, 3:]]
    extended = problem.replace(
        points=np.concatenate([problem.points, *added]),
        point_ids=np.concatenate([problem.point_ids, ids]),
    )
    factors = _factors(bodies, problem, ids.reshape(3, count).tolist(), motions, noise)
    result = solve_rounds(
        extended, options, factors=factors, priors=priors, align=False, progress=progress,
        **rounds.asdict(),
    )  # fmt: skip
    solved = result.problem
    num_points = solved.num_points - len(ids)
    velocities, gyro, accel = solved.points[num_points:].reshape(3, count, 3)
    refined = solved.replace(
        points=solved.points[:num_points], point_ids=solved.point_ids[:num_points]
    )
    done = tuple(
        dataclasses.replace(one, num_points=one.num_points - len(ids)) for one in result.rounds
    )
    result = dataclasses.replace(result, rounds=done)
    return result, MotionState(refined, velocities, np.hstack([gyro, accel]))


def _factors(
    bodies: ImuBodies,
    problem: Problem,
    points: list[list[int]],
    motions: list[Preintegration],
    noise: ImuNoise,
) -> list[Factor]:
    """Return the motions, then random walks and priors of the biases."""
    velocity, gyro, accel = ([("point", one) for one in part] for part in points)
    pose = bodies.keys(problem)
    factors: list[Factor] = [
        ImageImuFactor(
            pose[k], velocity[k], gyro[k], accel[k], pose[k + 1], velocity[k + 1], motion,
            bodies.body_from_imu, gravity=(0.0, 0.0, -GRAVITY),
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
