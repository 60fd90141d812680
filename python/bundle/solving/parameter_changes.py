"""Changes of lenses, sensors on rigs and rolling shutters by a solve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bundle.base.arrays import distinct
from bundle.base.records import dataclass
from bundle.interface.options import SolveOptions
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem
from bundle.model.rigid_motions import rotation_matrices

if TYPE_CHECKING:
    from bundle.solving.measured_result import MeasuredResult
    from bundle.solving.result import Result


@dataclass(frozen=True, kw_only=True)
class CameraChange:
    """The parameters of one camera before and after a solve.

    Attributes:
        camera_id: id of the camera in the input.
        model: COLMAP's name of the camera model.
        before: parameters by name before the solve, in pixels; distortion has no unit.
        after: parameters by name after the solve.
        movement: the largest change of a parameter. A change in pixels is divided by the focal
            length; a change of distortion is not scaled, for distortion acts on coordinates in
            focal lengths. This is about the angle in radians by which rays at 45 degrees from the
            axis move.
    """

    camera_id: int
    model: str
    before: dict[str, float]
    after: dict[str, float]
    movement: float


def camera_changes(solved: Result) -> list[CameraChange]:
    """Return the cameras that a solve changed, sorted by descending movement."""
    first, last = solved.initial_problem, solved.problem
    changes = []
    for camera in np.flatnonzero((first.camera_params != last.camera_params).any(axis=1)):
        model = last.camera_models[camera]
        names, kinds = camera_models()[model], np.array(param_kinds(model))
        before = first.camera_params[camera, : len(names)]
        after = last.camera_params[camera, : len(names)]
        focal = np.abs(before[kinds == "focal"]).mean() if "focal" in kinds else 1.0
        unit = np.where(np.isin(kinds, ("focal", "principal_point")), focal, 1.0)
        changes.append(
            CameraChange(
                camera_id=int(last.camera_ids[camera]),
                model=model,
                before=dict(zip(names, before.tolist(), strict=True)),
                after=dict(zip(names, after.tolist(), strict=True)),
                movement=float(np.abs((after - before) / unit).max()),
            )
        )
    return sorted(changes, key=lambda change: -change.movement)


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
    if not (options.refine_sensor_from_rig and "focal" in options.refine and last.num_sensors):
        return ""
    framed = last.image_frame >= 0
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
        f"{before:.6g} to {after:.6g}; fix one of them (--fix-sensors, --fix-cameras) unless the "
        "images determine both."
    )


class ShutterGain(NamedTuple):
    """RMSE before and after, and the size of the twists.

    Attributes:
        rmse_global: RMSE of the input if all shutters were global, pixels.
        rmse: RMSE of the result, pixels.
        turn: root mean square rotation of a twist, degrees per frame height.
        shift: root mean square translation of a twist, in the length unit.
    """

    rmse_global: float
    rmse: float
    turn: float
    shift: float


def shutter_gain(result: MeasuredResult) -> ShutterGain | None:
    """Return the gain of a result; None without rolling shutters."""
    shutter = result.problem.rolling_shutter
    if shutter is None or not shutter.is_rolling.any():
        return None
    twist = shutter.twist[shutter.is_rolling[result.problem.image_camera]]
    squares = (twist**2).reshape(-1, 2, 3).sum(axis=2).mean(axis=0) if len(twist) else (0.0, 0.0)
    return ShutterGain(
        result.rmse_global_shutters,
        result.reprojection_error_after.rmse,
        float(np.degrees(np.sqrt(squares[0]))),
        float(np.sqrt(squares[1])),
    )


def known_readouts(before: Problem, output: Mapping[str, Any]) -> tuple[Mapping[str, Any], str]:
    """Return the core's output without impossible readouts, and a warning or "".

    Such a readout becomes unknown (NaN).
    """
    if "readout" not in output:
        return output, ""
    readout = np.array(output["readout"])
    outside = ~np.isnan(readout) & ~((readout > 0) & (readout <= 1))
    if not outside.any():
        return output, ""
    camera = int(np.argmax(outside))
    warning = (
        f"The readout of camera {before.camera_ids[camera]} ended at {readout[camera]:.4g} of "
        "a frame, outside of 0 to 1: the images and ties do not determine it, or ties or times "
        "are wrong."
    )
    readout[outside] = np.nan
    return {**output, "readout": readout}, warning
