"""Camera edits of the command line, which run before all other steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

from bundle.base.records import dataclass
from bundle.editing.camera_sharing import cameras_by_size, share_cameras, split_cameras
from bundle.editing.model_change import CameraModelChange, change_camera_model
from bundle.errors import InputError
from bundle.model.problem import Problem
from bundle.model.residuals import ReprojectionError, reprojection_error


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraEdits:
    """Problem with edited cameras."""

    problem: Problem  # the new problem
    model: str | None  # new model of all cameras; None: unchanged
    changes: tuple[CameraModelChange, ...]  # results for the cameras that had another model
    # id of the camera into which others were merged, the first of several; None: no cameras were
    # merged
    shared_camera_id: int | None
    shared_camera_ids: tuple[int, ...]  # ids of all merged cameras, including this one
    # the same ids by the camera that they became; its id comes first
    shared_groups: tuple[tuple[int, ...], ...]
    num_copies: int | None  # number of cameras created for single images; None: no camera was split
    before: ReprojectionError  # reprojection errors of the given problem
    after: ReprojectionError  # reprojection errors of the new problem
    warnings: tuple[str, ...]  # one sentence for each bad fit
    stages: tuple[tuple[str, Problem], ...]  # name of each edit and the problem after it, in order

    def asdict(self) -> dict[str, Any]:
        """Return all fields except the problems, for JSON."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        errors = {name: dataclasses.asdict(fields.pop(name)) for name in ("before", "after")}
        del fields["problem"], fields["stages"]
        return fields | {
            "changes": [dataclasses.asdict(change) for change in self.changes],
            "reprojection_error": errors,
        }


def edit_cameras(
    problem: Problem,
    model: str | None = None,
    share: Iterable[int] | bool | str = False,
    split: bool = False,
    keep_scale: bool = False,
) -> CameraEdits | None:
    """Change models, then share or split cameras; return None if no edit is requested.

    Args:
        problem: problem to edit; not modified.
        model: model of all cameras; None: unchanged.
        share: ids of cameras to merge; True: all; "size": those of each image size.
        keep_scale: images move to keep their scale in a shared camera (``share_cameras``).
    """
    if model is None and share is False and not split:
        return None
    edited, stages = problem, []
    changes: tuple[CameraModelChange, ...] = ()
    warnings: tuple[str, ...] = ()
    if model is not None:
        changed = change_camera_model(problem, model)
        edited, changes, warnings = changed.problem, changed.changes, changed.warnings
        stages.append(("camera_model", edited))
    groups = [] if share is False else _groups(problem, share)
    for group in groups:
        edited = share_cameras(edited, group, keep_scale=keep_scale)
    if groups:
        stages.append(("share_cameras", edited))
    before_split = edited.num_cameras
    if split:
        edited = split_cameras(edited)
        stages.append(("split_cameras", edited))
    return CameraEdits(
        problem=edited,
        model=model,
        changes=changes,
        shared_camera_id=groups[0][0] if groups else None,
        shared_camera_ids=tuple(camera_id for group in groups for camera_id in group),
        shared_groups=tuple(map(tuple, groups)),
        num_copies=edited.num_cameras - before_split if split else None,
        before=reprojection_error(problem),
        after=reprojection_error(edited),
        warnings=warnings,
        stages=tuple(stages),
    )


def _groups(problem: Problem, share: Iterable[int] | bool | str) -> list[list[int]]:
    """Return the ids of the cameras to merge, by the camera that they become."""
    if share == "size":
        groups = cameras_by_size(problem)
        if not groups:
            raise InputError("camera_ids: expected cameras of one known image size, found 0")
        return groups
    assert not isinstance(share, str)
    return [sorted(problem.camera_ids.tolist() if share is True else set(share))]  # type: ignore[arg-type]
