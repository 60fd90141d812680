"""Changes of the poses of sensors on their rigs by a solve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.base.arrays import distinct
from bundle.base.records import dataclass
from bundle.interface.options import SolveOptions
from bundle.model.cameras import param_kinds
from bundle.model.problem import Problem
from bundle.model.rotations import rotation_matrices

if TYPE_CHECKING:
    from bundle.solving.result import Result

WEAK_CHANGE = 0.02
"""Smallest common relative change of a focal length and a baseline that causes a warning."""


@dataclass(frozen=True, kw_only=True)
class SensorChange:
    """The pose of one sensor on its rig before and after a solve.

    Attributes:
        rig_id: id of the rig in the input.
        camera_id: id of the camera in the input.
        baseline_before: distance from the rig's origin before the solve, in the reconstruction's
            length unit.
        baseline_after: the same distance after the solve.
        rotation: angle between the two orientations, in degrees.
    """

    rig_id: int
    camera_id: int
    baseline_before: float
    baseline_after: float
    rotation: float


def sensor_changes(solved: Result) -> list[SensorChange]:
    """Return the sensors that a solve moved, sorted by descending change of the baseline."""
    return _changes(solved.initial_problem, solved.problem)


def _changes(initial: Problem, problem: Problem) -> list[SensorChange]:
    first, last = initial.sensor_from_rig, problem.sensor_from_rig
    moved = np.flatnonzero((first != last).any(axis=1))
    before, after = (np.linalg.norm(poses[moved, 4:], axis=1) for poses in (first, last))
    turns = np.swapaxes(rotation_matrices(first[moved, :4]), 1, 2)
    turns = rotation_matrices(last[moved, :4]) @ turns
    # Use twice the sine and cosine of the angle: the cosine alone is inaccurate near zero.
    skew = np.stack([turns[:, i, j] - turns[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
    cosine = np.trace(turns, axis1=1, axis2=2) - 1
    angles = np.degrees(np.arctan2(np.linalg.norm(skew, axis=1), cosine))
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


def weak_baseline(
    options: SolveOptions, first: Problem, last: Problem, summary: Mapping[str, Any]
) -> str:
    """Return a warning if a focal length and a baseline changed together, else "".

    A longer baseline with longer lenses gives nearly the same images. Only the change of
    perspective within an image distinguishes the two. A solve can therefore move far along this
    direction for a small decrease of the cost.
    """
    if not options.refine_sensor_from_rig or "focal" not in options.refine:
        return ""
    framed = last.image_frame >= 0 if last.num_frames else np.zeros(last.num_images, bool)
    focal = (0.0, "")
    for camera in distinct(last.image_camera[framed]).tolist():
        for column, kind in enumerate(param_kinds(last.camera_models[camera])):
            if kind == "focal":
                before, after = (p.camera_params[camera, column] for p in (first, last))
                lens = f"(camera {last.camera_ids[camera]})"
                words = f"focal length {before:.6g} -> {after:.6g} px {lens}"
                focal = max(focal, (abs(after / before - 1), words))
    arm = (0.0, "")
    for change in _changes(first, last):
        if change.baseline_before > 0:
            words = (
                f"baseline {change.baseline_before:.4g} -> {change.baseline_after:.4g} "
                f"(sensor {change.rig_id}:{change.camera_id})"
            )
            arm = max(arm, (abs(change.baseline_after / change.baseline_before - 1), words))
    if min(focal[0], arm[0]) < WEAK_CHANGE:
        return ""
    before, after = summary["initial_cost"], summary["final_cost"]
    return (
        f"Weakly determined: {focal[1]} and {arm[1]} changed together, while the cost went from "
        f"{before:.6g} to {after:.6g}; hold one of them (--fix-sensors, --fix-cameras) unless the "
        "images determine both."
    )
