"""Changes of the intrinsics of each camera by a solve."""

from __future__ import annotations

import numpy as np

from bundle.base.records import dataclass
from bundle.model.cameras import camera_models, param_kinds
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
