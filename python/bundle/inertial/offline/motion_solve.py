"""Solve of a reconstruction with preintegrated motions between the bodies that carry its IMU.

The cost gains, for consecutive images, the factors of ``cpp/core/factors/image_imu_factor.h`` and
random walks of the biases. Velocities and biases are three numbers each, and additional points of
the problem without observations; the result does not have them. A filter between adjustments (see
``solving/rounds``) keeps them, because factors name them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import refuse_row
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.georeference.similarity import Similarity, moved
from bundle.graphs.factors.factors import BetweenFactor, Factor, PriorFactor
from bundle.inertial.preintegration.imu_factors import ImageImuFactor
from bundle.inertial.preintegration.preintegration import Preintegration
from bundle.interface.options import SolveOptions
from bundle.interface.solve_record import Progress
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices
from bundle.model.sequence.calibration import ImuNoise
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result
from bundle.solving.rounds.plan import RunPlan
from bundle.solving.rounds.solve_rounds import run

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior

Array = NDArray[np.float64]

GRAVITY = 9.81  # length of gravity, m/s^2
GYRO_BIAS_SIGMA, ACCEL_BIAS_SIGMA = 0.1, 0.3  # weak priors of the first biases, rad/s and m/s^2


class MotionState(NamedTuple):
    """Problem, and velocities (n, 3) and biases (n, 6) in the order of time."""

    problem: Problem
    velocities: Array
    biases: Array

    def scaled(self, factor: float) -> MotionState:
        """Return the state with other lengths, at the same reprojection errors."""
        by = Similarity(factor, np.eye(3), np.zeros(3))
        return MotionState(moved(self.problem, by), factor * self.velocities, self.biases)


def solved_with_motions(
    state: MotionState,
    bodies: ImuBodies,
    motions: list[Preintegration],
    noise: ImuNoise,
    priors: tuple[Prior, ...],
    options: SolveOptions,
    plan: RunPlan,
    progress: Progress | None,
) -> tuple[Result, MotionState]:
    """Run a plan from a state; motions between consecutive bodies and priors are its factors."""
    problem, count = state.problem, len(bodies)
    first_id = int(problem.point_ids.max(initial=0)) + 1
    ids = first_id + np.arange(3 * count)
    added = [state.velocities, state.biases[:, :3], state.biases[:, 3:]]
    extended = problem.replace(
        points=np.concatenate([problem.points, *added]),
        point_ids=np.concatenate([problem.point_ids, ids]),
    )
    factors = _factors(bodies, problem, ids.reshape(3, count).tolist(), motions, noise)
    request = SolveRequest(
        problem=extended, options=options, factors=factors, priors=priors, align=False
    )
    result = run(request, plan, progress)
    velocities, gyro, accel = result.problem.points[-len(ids) :].reshape(3, count, 3)
    result = result.without_last_points(len(ids))
    return result, MotionState(result.problem, velocities, np.hstack([gyro, accel]))


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


@dataclass(frozen=True, eq=False)
class ImuBodies:
    """Images or frames that carry the IMU, in the order of time."""

    kind: str  # "image" or "frame"
    rows: NDArray[np.intp]  # (n,) indices of the images or frames in the problem
    stamps: NDArray[np.int64]  # (n,) times in ns
    # (7,) qx qy qz qw tx ty tz, metres; the body's axes are those of the image's camera, or of the
    # rig's reference sensor
    body_from_imu: Array

    @staticmethod
    def of(problem: Problem, image_times_ns: Any, camera_from_imu: Any) -> ImuBodies:
        """Return the bodies of a problem.

        ``image_times_ns``: (num_images,) times; equal for the images of a frame.
        ``camera_from_imu``: (7,) of each image, or of the images of the reference sensor.
        """
        times = np.asarray(image_times_ns, np.int64)
        arm = np.asarray(camera_from_imu, np.float64)
        kind = "image"
        if problem.num_frames:
            kind, times = "frame", _frame_times(problem, times)
        order = np.argsort(times, kind="stable")
        return ImuBodies(kind, order, times[order], arm)

    def __len__(self) -> int:
        return len(self.rows)

    def keys(self, problem: Problem) -> list[tuple[str, int]]:
        """Return the keys of the poses as variables of factors."""
        ids = problem.image_ids if self.kind == "image" else problem.frame_ids
        return [(self.kind, one) for one in ids[self.rows].tolist()]

    def imu_rotations(self, problem: Problem) -> Array:
        """Return the (n, 3, 3) rotations world_from_imu."""
        body_from_imu = rotation_matrices(self.body_from_imu[None, :4])[0]
        turned: Array = self.axes(problem) @ body_from_imu
        return turned

    def centers(self, problem: Problem) -> Array:
        """Return the (n, 3) origins of the bodies in the world."""
        shifts = self._poses(problem)[:, 4:]
        found: Array = -np.einsum("nij,nj->ni", self.axes(problem), shifts)
        return found

    def arms(self, problem: Problem) -> Array:
        """Return the (n, 3) vectors from body to IMU along the axes of the world, in metres."""
        along: Array = self.axes(problem) @ self.body_from_imu[4:]
        return along

    def _poses(self, problem: Problem) -> Array:
        poses = problem.cam_from_world if self.kind == "image" else problem.rig_from_world
        return np.asarray(poses[self.rows])

    def axes(self, problem: Problem) -> Array:
        """Return the (n, 3, 3) rotations world_from_body."""
        rotations: Array = rotation_matrices(self._poses(problem)[:, :4])
        return np.swapaxes(rotations, 1, 2)


def _frame_times(problem: Problem, times: NDArray[np.int64]) -> NDArray[np.int64]:
    frame = problem.image_frame
    beside = int((frame < 0).sum())
    if problem.num_rigs > 1 or beside:
        raise InputError(
            f"imu: expected all images on one rig, found {plural(problem.num_rigs, 'rig')} and "
            f"{plural(beside, 'image')} without a rig"
        )
    if not (problem.image_sensor < 0).any():
        raise InputError(
            "imu: expected images of the rig's reference sensor, to which camera_from_imu refers, "
            "found 0"
        )
    first = np.zeros(problem.num_frames, np.int64)
    first[frame[::-1]] = times[::-1]
    refuse_row(
        times != first[frame],
        lambda image: (
            f"imu: expected one time for the images of a frame, found {int(times[image])} ns of "
            f"image {int(problem.image_ids[image])} and {int(first[frame[image]])} ns"
        ),
    )
    return first
