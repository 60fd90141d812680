"""Errors of an estimated trajectory relative to ground truth.

Ground truth is interpolated at the stamps of the estimate: positions linearly, rotations along the
shortest arc. Errors (``model.pose_table``) are computed after two alignments
(``georeference.pose_alignment``):

* all six degrees of freedom: papers report this absolute trajectory error; its variant with a free
  scale shows by how much the estimate is too small;
* yaw and position, the four degrees of freedom that an odometry with an IMU does not determine.
  This alignment does not hide errors of roll and pitch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.model.pose_table import ErrorStatistics, absolute_errors
from bundle.model.rigid_motions import (
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_multiply,
    vector_from_quaternion,
)
from bundle.model.sequence.sequence import other_unit

Array = NDArray[np.float64]

LEAST_POSES = 3


@dataclass(frozen=True, repr=False)
class TrajectoryError(Displayed):
    """Errors over all poses that both trajectories cover.

    Attributes:
        num_poses: number of compared poses.
        ate: rms of position errors [m] after an alignment of all six degrees of freedom.
        ate_yaw: the same after an alignment of yaw and position alone [m].
        scale: factor of the estimate that gives the best fit; nan without motion.
        rotation_rms: rms of rotation errors [degrees] after the alignment of yaw and position.
        path_length: length of the true path [m].
    """

    num_poses: int
    ate: float
    ate_yaw: float
    scale: float
    rotation_rms: float
    path_length: float

    def _display(self) -> Display:
        return Display(
            title=f"Errors of {self.num_poses} poses along {self.path_length:.4g} m",
            facts=(
                ("ATE", f"{self.ate:.4g} m; aligned in yaw and position only {self.ate_yaw:.4g} m"),
                ("scale", f"{self.scale:.6g}"),
                ("rotation", f"{self.rotation_rms:.4g} degrees rms"),
            ),
        )


def compare_trajectories(estimate: Trajectory, truth: Trajectory) -> TrajectoryError:
    """Compare an estimate with ground truth where both exist.

    Raises:
        InputError: fewer than three poses of the estimate lie between stamps of the truth.
    """
    # Import late: the room takes 80 ms.
    from bundle.georeference.pose_alignment import align_centers, moved_poses

    stamps, level, wanted = aligned_in_yaw(estimate, truth)
    found = estimate.states[np.isin(estimate.timestamps_ns, stamps), :7]
    rigid, scale = level, float("nan")
    try:
        rigid = moved_poses(found, align_centers(found[:, 4:], wanted[:, 4:], "rigid"))
        scale = align_centers(found[:, 4:], wanted[:, 4:]).scale
    except InputError:  # on one line: positions do not determine the rotation about it
        pass
    position, rotation = absolute_errors(level, wanted)
    return TrajectoryError(
        num_poses=len(stamps),
        ate=ErrorStatistics.of(absolute_errors(rigid, wanted)[0]).rmse,
        ate_yaw=ErrorStatistics.of(position).rmse,
        scale=scale,
        rotation_rms=ErrorStatistics.of(rotation).rmse,
        path_length=float(np.linalg.norm(np.diff(wanted[:, 4:], axis=0), axis=1).sum()),
    )


def aligned_in_yaw(
    estimate: Trajectory, truth: Trajectory
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return stamps (n,), poses of the estimate and of the truth, (n, 7), where both exist.

    The estimate is rotated about the vertical and translated to fit the truth best.
    """
    from bundle.georeference.pose_alignment import align_centers, moved_poses  # late, as above

    inside = covered_by(truth, estimate.timestamps_ns)
    stamps = estimate.timestamps_ns[inside]
    found, wanted = estimate.states[inside, :7], states_at(truth, stamps)[:, :7]
    similarity = align_centers(found[:, 4:], wanted[:, 4:], "yaw")
    return stamps, moved_poses(found, similarity), wanted


def states_at(trajectory: Trajectory, stamps: NDArray[np.int64]) -> Array:
    """Return interpolated states (n, 16) at stamps within the trajectory."""
    times, states = trajectory.timestamps_ns, trajectory.states
    after = np.clip(np.searchsorted(times, stamps), 1, max(len(times) - 1, 1))
    after = np.minimum(after, len(times) - 1)
    before = np.maximum(after - 1, 0)
    share = (stamps - times[before]) / np.maximum(times[after] - times[before], 1)
    result: Array = states[before] + share[:, None] * (states[after] - states[before])
    turn = quaternion_multiply(quaternion_inverse(states[before, :4]), states[after, :4])
    part = quaternion_from_vector(share[:, None] * vector_from_quaternion(turn))
    result[:, :4] = quaternion_multiply(states[before, :4], part)
    return result


def covered_by(truth: Trajectory, stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return the mask of an estimate's stamps that lie between those of the truth."""
    inside: NDArray[np.bool_] = stamps >= truth.timestamps_ns[0]
    inside = inside & (stamps <= truth.timestamps_ns[-1])
    if inside.sum() < LEAST_POSES:
        raise InputError(
            f"ground truth: expected at least {LEAST_POSES} poses of the estimate between "
            f"{truth.timestamps_ns[0]} and {truth.timestamps_ns[-1]} ns, found {int(inside.sum())}"
            f"{other_unit(truth.timestamps_ns, stamps)}"
        )
    return inside
