"""Shared cameras: merge several into one, split one into several; all edits of a command.

Scale. An image of points at about the depth z has the scale f / z. A merged camera has another f
than the image's own, f_i, and at a fixed pose the scale of the image would change: by 60 px at the
border for 20 %. The views often determine f / z much better than f, so that a solve would undo that
change in hundreds of small steps. The pose that keeps the scale at the median depth is near the
minimum instead: t_z grows by (f / f_i - 1) z.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import as_integers, refuse_row
from bundle.base.records import dataclass
from bundle.editing.model_change import CameraModelChange, change_camera_model
from bundle.errors import InputError
from bundle.io.files import Source, as_problem
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem
from bundle.model.residuals import ReprojectionError, reprojection_error
from bundle.model.rigid_motions import quaternion_rotate
from bundle.model.shutter_motion import check_same_shutter, shutter_of_cameras

MAX_ID = 2**32 - 2  # COLMAP's largest camera id


def share_cameras(
    problem: Source, camera_ids: Iterable[int] | None = None, *, keep_scale: bool = False
) -> Problem:
    """Merge several cameras into the camera with the lowest id, which all their images get.

    The parameters of the merged camera are means, weighted by the numbers of observations (with
    equal weights if the cameras have no observations). Errors grow if the cameras differed. Solve
    again afterwards.

    Args:
        problem: Problem, path of one, or pycolmap.Reconstruction; not modified.
        camera_ids: ids of at least two cameras; None: all.
        keep_scale: True to move each image along its axis, so that it keeps its scale at the median
            depth of its points: a nearer start for a solve. False: poses do not change.

    Raises:
        InputError: a camera does not exist, cameras differ in model or image size, there are fewer
            than two cameras, or a camera is a sensor of a rig with several sensors.
        OSError: the path cannot be read.
    """
    problem = as_problem(problem)
    cameras = _chosen(problem, camera_ids)
    first = int(cameras[0])
    _check_alike(problem, cameras)
    check_same_shutter(problem, cameras)
    _check_rigs(problem, np.flatnonzero(np.isin(problem.image_camera, cameras)))
    params = problem.camera_params.copy()
    params[first] = _mean(problem, cameras)
    stays = np.ones(problem.num_cameras, bool)
    stays[cameras[1:]] = False
    index = np.cumsum(stays, dtype=np.int32) - np.int32(1)
    index[cameras] = index[first]
    if keep_scale:
        moved = _with_scale(problem, cameras, params[first])
        problem = problem.replace(cam_from_world=moved)
    return problem.replace(
        image_camera=index[problem.image_camera],
        **_cameras(problem, np.flatnonzero(stays), params),
    )


def _with_scale(
    problem: Problem, cameras: NDArray[np.int64], params: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Move the images of cameras along their axis so that new parameters keep their scale."""
    kinds = param_kinds(problem.camera_models[int(cameras[0])])
    focal = [k for k, kind in enumerate(kinds) if kind == "focal"]
    own = problem.camera_params[:, focal].mean(axis=1) if focal else np.zeros(problem.num_cameras)
    image, poses = problem.observation_image, problem.cam_from_world.copy()
    rays = quaternion_rotate(poses[image, :4], problem.points[problem.observation_point])
    depth = rays[:, 2] + poses[image, 6]
    is_chosen = np.isin(problem.image_camera, cameras) & (own[problem.image_camera] > 0)
    for row in np.flatnonzero(is_chosen & (np.bincount(image, minlength=len(poses)) > 0)).tolist():
        middle = float(np.median(depth[image == row]))
        change = float(params[focal].mean() / own[problem.image_camera[row]]) - 1.0
        if middle > 0 and change > -1.0:
            poses[row, 6] += change * middle
    return poses


def cameras_by_size(problem: Problem) -> list[list[int]]:
    """Return the ids of the cameras of each image size, for sizes with two or more cameras.

    Cameras without an image and cameras of unknown size are ignored.
    """
    used = np.unique(problem.image_camera)
    used = used[(problem.camera_sizes[used] > 0).all(axis=1)]
    groups: dict[tuple[int, ...], list[int]] = {}
    for camera in used.tolist():
        size = tuple(problem.camera_sizes[camera].tolist())
        groups.setdefault(size, []).append(int(problem.camera_ids[camera]))
    return [sorted(ids) for ids in groups.values() if len(ids) > 1]


def split_cameras(problem: Source) -> Problem:
    """Give every image its own camera.

    The first image of a camera keeps this camera. Each other image gets a copy. The id of the copy
    is the next id above all existing ids, or the lowest unused id if COLMAP's range is exhausted.
    Cameras without an image are kept.

    Args:
        problem: Problem, path of one, or pycolmap.Reconstruction; not modified.

    Raises:
        InputError: an image belongs to a rig with several sensors, in which sensors are cameras.
        OSError: the path cannot be read.
    """
    problem = as_problem(problem)
    _, owners = np.unique(problem.image_camera, return_index=True)
    copies = np.setdiff1d(np.arange(problem.num_images), owners)
    if not len(copies):
        return problem
    _check_rigs(problem, copies)
    image_camera = problem.image_camera.copy()
    image_camera[copies] = problem.num_cameras + np.arange(len(copies))
    rows = np.concatenate([np.arange(problem.num_cameras), problem.image_camera[copies]])
    ids = np.concatenate([problem.camera_ids, _free_ids(problem.camera_ids, len(copies))])
    return problem.replace(
        image_camera=image_camera,
        **{**_cameras(problem, rows, problem.camera_params), "camera_ids": ids},
    )


def _cameras(
    problem: Problem, rows: NDArray[np.int64], params: NDArray[np.float64]
) -> dict[str, Any]:
    """Return the fields of a problem for some cameras."""
    return {
        "camera_ids": problem.camera_ids[rows],
        "camera_models": tuple(problem.camera_models[row] for row in rows.tolist()),
        "camera_params": params[rows],
        "camera_sizes": problem.camera_sizes[rows],
        "rolling_shutter": shutter_of_cameras(problem.rolling_shutter, rows),
    }


def _chosen(problem: Problem, camera_ids: Iterable[int] | None) -> NDArray[np.int64]:
    """Return indices of cameras in the order of their ids."""
    wanted = problem.camera_ids if camera_ids is None else as_integers("camera_ids", camera_ids)
    ids = np.unique(wanted)
    refuse_row(
        ~np.isin(ids, problem.camera_ids),
        lambda k: f"camera_ids: camera {ids[k]} is not in the problem",
    )
    if len(ids) < 2:
        raise InputError(f"camera_ids: expected at least two cameras to share, found {len(ids)}")
    order = np.argsort(problem.camera_ids)
    return order[np.isin(problem.camera_ids[order], ids)]


def _check_rigs(problem: Problem, images: NDArray[np.int64]) -> None:
    """Refuse images whose camera is determined by a rig."""
    if not len(problem.image_frame):
        return
    frame = problem.image_frame[images]
    refuse_row(
        frame >= 0,
        lambda k: (
            f"image {problem.image_ids[images[k]]}: expected an image without a rig to get another "
            f"camera, found an image of frame {problem.frame_ids[frame[k]]}"
        ),
    )


def _check_alike(problem: Problem, cameras: NDArray[np.int64]) -> None:
    first = int(cameras[0])
    for camera in cameras[1:].tolist():
        for what, values in (
            ("model", problem.camera_models),
            ("size", [f"{width} x {height}" for width, height in problem.camera_sizes.tolist()]),
        ):
            if values[camera] != values[first]:
                raise InputError(
                    f"camera {problem.camera_ids[camera]}: expected the {what} of camera "
                    f"{problem.camera_ids[first]} ({values[first]}) to share it, "
                    f"found {values[camera]}"
                )


def _mean(problem: Problem, cameras: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the mean of parameters. The mean of equal parameters is exact bit for bit."""
    params = problem.camera_params[cameras]
    camera_of = problem.image_camera[problem.observation_image]
    weights = np.bincount(camera_of, minlength=problem.num_cameras)[cameras].astype(float)
    if not weights.any():
        weights[:] = 1.0
    first = params[0]
    kinds = np.array(param_kinds(problem.camera_models[int(cameras[0])]))
    metadata = np.flatnonzero(kinds == "metadata")
    if (params[:, metadata] != first[metadata]).any():
        names = camera_models()[problem.camera_models[int(cameras[0])]]
        raise InputError(
            f"camera {problem.camera_ids[cameras[0]]}: expected cameras to share with the "
            f"same {' and '.join(names[index] for index in metadata)}, found different "
            "values"
        )
    # Average differences to the first value, so that the mean of equal values is exact.
    mean: NDArray[np.float64] = first + weights @ (params - first) / weights.sum()
    return mean


def _free_ids(taken: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return ids above all used ids; if the range is exhausted, the lowest unused ids."""
    start = int(taken.max(initial=0)) + 1
    if start + count - 1 <= MAX_ID:
        return np.arange(start, start + count, dtype=np.int64)
    return np.setdiff1d(np.arange(1, count + len(taken) + 1, dtype=np.int64), taken)[:count]


# All edits of the cameras that a command line asks for. They run before its other steps.


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
