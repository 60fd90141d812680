"""Rigs whose sensors share one position; like a panorama head they do not determine the scale."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bundle.analysis.diagnosis.conditioning import Finding
from bundle.model.problem import Problem
from bundle.model.rotations import quaternion_inverse, quaternion_rotate

__all__ = ["rigs_without_baseline"]

NO_BASELINE = 1e-4
"""Share of the points' distance, below which sensors count as being at the same position."""


def rigs_without_baseline(problem: Problem) -> Iterator[Finding]:
    """Yield a finding for each rig of several sensors at one position."""
    if not problem.num_sensors or not problem.num_observations:
        return
    poses = problem.sensor_from_rig
    back = quaternion_inverse(poses[:, :4] / np.linalg.norm(poses[:, :4], axis=1, keepdims=True))
    reach = np.linalg.norm(quaternion_rotate(back, poses[:, 4:]), axis=1)
    centers = problem.projection_centers[problem.observation_image]
    away = np.linalg.norm(problem.points[problem.observation_point] - centers, axis=1)
    distance = float(np.median(away))
    for rig in np.unique(problem.sensor_rig_ids).tolist():
        own = problem.sensor_rig_ids == rig
        if float(reach[own].max()) >= NO_BASELINE * distance:
            continue
        yield Finding(
            kind="rig_without_baseline",
            is_problem=True,
            sentence=f"Rig {rig}: its {int(own.sum()) + 1} sensors stand at one place, so that it "
            "gives no scale: that of the world is arbitrary, as without a rig. Give the sensors "
            "their distances (sensor_from_rig), or the scale by positions or control points.",
        )
