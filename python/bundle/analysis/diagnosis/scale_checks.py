"""Checks of the scale: rigs that do not determine it, and its drift in a solve.

Rigs whose sensors share one position do not determine the scale, like a panorama head.

Images and points alone do not determine the scale. A solve without a fixed scale may shrink the
world a little at each step, geometrically. The cost does not change, but after many steps numbers
lose digits.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bundle.base.records import dataclass
from bundle.interface.finding import Finding
from bundle.model.problem import Problem
from bundle.model.rotations import quaternion_inverse, quaternion_rotate
from bundle.solving.result import Result

NO_BASELINE = 1e-4
"""Share of the points' distance, below which sensors count as being at the same position."""


@dataclass(frozen=True)
class ScaleDrift:
    """Scale of a world after a solve.

    Attributes:
        factor: ratio of the spread of the camera centres after and before the solve.
        num_steps: accepted steps of the solve, at least 1.
    """

    factor: float
    num_steps: int

    @property
    def per_step(self) -> float:
        """Geometric mean of the factors of the steps."""
        return float(self.factor ** (1.0 / self.num_steps))


def scale_drift(result: Result) -> ScaleDrift | None:
    """Return the scale change by a solve.

    Return None if the result was aligned, or if all camera centres were the same at the start.
    """
    before, after = (
        float(np.linalg.norm(centers - centers.mean(axis=0)))
        for centers in (
            result.initial_problem.projection_centers,
            result.problem.projection_centers,
        )
    )
    if not before > 0 or result.similarity is not None:
        return None
    accepted = np.asarray(result.iterations["step_is_successful"], bool)
    return ScaleDrift(after / before, max(int(accepted[1:].sum()), 1))


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
