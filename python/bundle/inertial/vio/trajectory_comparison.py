"""Errors of an estimated trajectory relative to ground truth, by evo.

https://github.com/MichaelGrupp/evo

Ground truth is interpolated at the stamps of the estimate: positions linearly, rotations along the
shortest arc. Errors are computed after two alignments:

* all six degrees of freedom (Umeyama, by evo): papers report this absolute trajectory error; its
  variant with a free scale shows by how much the estimate is too small;
* yaw and position, the four degrees of freedom that an odometry with an IMU leaves open. Errors of
  roll and pitch are not aligned away. The yaw a maximises sum q_i . R_z(a) p_i over centred
  positions p of the estimate and q of the truth: tan a =
  sum (p_x q_y - p_y q_x) / sum (p_x q_x + p_y q_y).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.errors import InputError
from bundle.io.sequences.trajectory_files import Trajectory
from bundle.model.rotations import (
    quaternion_from_vector,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_rotate,
    vector_from_quaternion,
)
from bundle.model.sequence.stamp_units import other_unit

__all__ = [
    "TrajectoryError",
    "aligned_in_yaw",
    "compare_trajectories",
    "covered_by",
    "states_at",
]

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
                ("ATE", f"{self.ate:.4g} m; yaw and position aligned alone {self.ate_yaw:.4g} m"),
                ("scale", f"{self.scale:.6g}"),
                ("rotation", f"{self.rotation_rms:.4g} degrees rms"),
            ),
        )


def compare_trajectories(estimate: Trajectory, truth: Trajectory) -> TrajectoryError:
    """Compare an estimate with ground truth where both exist.

    Raises:
        InputError: fewer than three poses of the estimate lie between stamps of the truth, or evo
            is not installed.
    """
    try:
        from evo.core import metrics  # optional dependency
        from evo.core.trajectory import PosePath3D  # optional dependency
    except ImportError:
        raise InputError(
            "compare_trajectories: expected the package evo, which is not installed: pip "
            "install evo"
        ) from None
    inside = covered_by(truth, estimate.timestamps_ns)
    found = estimate.states[inside, :7]
    wanted = states_at(truth, estimate.timestamps_ns[inside])[:, :7]

    def path(poses: Array) -> PosePath3D:
        return PosePath3D(positions_xyz=poses[:, 4:], orientations_quat_wxyz=poses[:, [3, 0, 1, 2]])

    def rms(aligned: PosePath3D, relation: metrics.PoseRelation) -> float:
        error = metrics.APE(relation)
        error.process_data((path(wanted), aligned))
        return float(error.get_statistic(metrics.StatisticsType.rmse))

    position = metrics.PoseRelation.translation_part
    level = path(_yaw_aligned(found, wanted))
    rigid, scale = path(found), float("nan")
    centred = [poses[:, 4:] - poses[:, 4:].mean(axis=0) for poses in (found, wanted)]
    if all(np.linalg.matrix_rank(points, tol=1e-9) >= 2 for points in centred):
        rigid.align(path(wanted))
        scale = float(path(found).align(path(wanted), correct_scale=True)[2])
    else:  # collinear: positions do not determine the rotation about the line
        rigid = level
    return TrajectoryError(
        num_poses=int(inside.sum()),
        ate=rms(rigid, position),
        ate_yaw=rms(level, position),
        scale=scale,
        rotation_rms=rms(level, metrics.PoseRelation.rotation_angle_deg),
        path_length=float(np.linalg.norm(np.diff(wanted[:, 4:], axis=0), axis=1).sum()),
    )


def aligned_in_yaw(
    estimate: Trajectory, truth: Trajectory
) -> tuple[NDArray[np.int64], Array, Array]:
    """Return stamps (n,), poses of the estimate and of the truth, (n, 7), where both exist.

    The estimate is rotated about the vertical and translated to fit the truth best.

    Raises:
        InputError: fewer than three poses of the estimate lie between stamps of the truth.
    """
    inside = covered_by(truth, estimate.timestamps_ns)
    stamps = estimate.timestamps_ns[inside]
    wanted = states_at(truth, stamps)[:, :7]
    return stamps, _yaw_aligned(estimate.states[inside, :7], wanted), wanted


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
    """Return the mask of an estimate's stamps that lie between those of the truth.

    Raises:
        InputError: fewer than three lie between them.
    """
    inside: NDArray[np.bool_] = stamps >= truth.timestamps_ns[0]
    inside = inside & (stamps <= truth.timestamps_ns[-1])
    if inside.sum() < LEAST_POSES:
        raise InputError(
            f"ground truth: expected at least {LEAST_POSES} poses of the estimate between "
            f"{truth.timestamps_ns[0]} and {truth.timestamps_ns[-1]} ns, found {int(inside.sum())}"
            f"{other_unit(truth.timestamps_ns, stamps)}"
        )
    return inside


def _yaw_aligned(found: Array, wanted: Array) -> Array:
    p, q = (poses[:, 4:] - poses[:, 4:].mean(axis=0) for poses in (found, wanted))
    yaw = np.arctan2(
        np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]), np.sum(p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1])
    )
    turn = np.broadcast_to([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)], (len(found), 4))
    position = quaternion_rotate(turn, p) + wanted[:, 4:].mean(axis=0)
    return np.hstack([quaternion_multiply(turn, found[:, :4]), position])
