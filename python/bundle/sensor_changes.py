"""How a solve moved sensors on their rigs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bundle.result import Result
from bundle.rotations import rotation_matrices

__all__ = ["SensorChange", "sensor_changes"]


@dataclass(frozen=True, kw_only=True)
class SensorChange:
    """The pose of one sensor on its rig before and after a solve.

    Attributes:
        rig_id: of the source.
        camera_id: of the source.
        baseline_before: distance from the rig's origin, in the reconstruction's length unit.
        baseline_after: likewise.
        rotation: angle between the two orientations, in degrees.
    """

    rig_id: int
    camera_id: int
    baseline_before: float
    baseline_after: float
    rotation: float


def sensor_changes(solved: Result) -> list[SensorChange]:
    """Return the sensors that a solve moved, the largest change of the baseline first."""
    first, last = solved.initial_problem.sensor_from_rig, solved.problem.sensor_from_rig
    moved = np.flatnonzero((first != last).any(axis=1))
    before, after = (np.linalg.norm(poses[moved, 4:], axis=1) for poses in (first, last))
    turns = np.swapaxes(rotation_matrices(first[moved, :4]), 1, 2)
    turns = rotation_matrices(last[moved, :4]) @ turns
    # Twice the sine and cosine of the angle: exact near zero, where its cosine alone is not.
    skew = np.stack([turns[:, i, j] - turns[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
    cosine = np.trace(turns, axis1=1, axis2=2) - 1
    angles = np.degrees(np.arctan2(np.linalg.norm(skew, axis=1), cosine))
    problem = solved.problem
    changes = [
        SensorChange(
            rig_id=int(problem.sensor_rig_ids[row]),
            camera_id=int(problem.sensor_camera_ids[row]),
            baseline_before=float(before[k]),
            baseline_after=float(after[k]),
            rotation=float(angles[k]),
        )
        for k, row in enumerate(moved)
    ]
    return sorted(changes, key=lambda change: -abs(change.baseline_after - change.baseline_before))
