"""Selections: sub-problems with some images, cameras, points and observations of a problem.

Refined values of a selection can be put back into the original problem. Selected rows keep their
order and their ids; indices refer to the rows of the selection. An observation is selected if its
mask, its image and its point are selected. The frames of selected images, and all sensors of the
rigs of these frames, are selected too.

Values are not checked again, because the original problem was checked. If images or cameras are
left out, a selection has no source and its observations have no keypoint indices.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.base.arrays import distinct, filled, freeze, refuse_row
from bundle.base.records import dataclass
from bundle.errors import InputError, brief
from bundle.model import rig_arrays
from bundle.model.estimates import VARIABLES, arrays_of, estimates, with_estimates
from bundle.model.problem_arrays import ProblemArrays
from bundle.model.rolling_shutter import RollingShutter, selected

_Indices = NDArray[np.int64]
_Mask = NDArray[np.bool_]


P = TypeVar("P", bound=ProblemArrays)


@dataclass(frozen=True)
class Selection(Generic[P]):
    """A sub-problem, and the rows of the original problem that it contains.

    Attributes:
        problem: the sub-problem, with the original ids; the original problem if all is selected.
        images: indices of the selected images in the original problem, ascending.
        cameras: as ``images``, for cameras.
        points: as ``images``, for points.
        observations: as ``images``, for observations.
        frames: as ``images``, for frames.
        sensors: as ``images``, for sensors.
    """

    problem: P
    images: _Indices
    cameras: _Indices
    points: _Indices
    observations: _Indices
    frames: _Indices
    sensors: _Indices

    def restricted(self, observations: _Mask, points: _Mask) -> Selection[P]:
        """Return a selection with those observations and points of this one that masks keep."""
        left = select(self.problem, points=points, observations=observations)
        return replace(
            self,
            problem=left.problem,
            points=self.points[left.points],
            observations=self.observations[left.observations],
        )

    def put_back(
        self,
        whole: P,
        refined: P,
        *,
        images: _Mask | None = None,
        frames: _Mask | None = None,
        cameras: _Mask | None = None,
        points: _Mask | None = None,
        sensors: _Mask | None = None,
    ) -> P:
        """Return the original problem with refined values of the selection inserted.

        Args:
            whole: the original problem.
            refined: the sub-problem with new values.
            images: mask of the selected images whose poses are inserted; None: all.
            frames: as ``images``, for the poses of frames.
            cameras: as ``images``, for the parameters of cameras.
            points: as ``images``, for the coordinates of points.
            sensors: as ``images``, for the poses of sensors on their rigs.
        """
        chosen = {"images": images, "frames": frames, "cameras": cameras, "points": points}
        chosen["sensors"] = sensors
        old, new = estimates(whole), estimates(refined)
        values: dict[str, Any] = {}
        for one in VARIABLES:
            rows, mask = getattr(self, one.rows), chosen.get(one.rows)
            if one.name in old and one.name in new and len(rows):
                mask = np.ones(len(rows), bool) if mask is None else mask
                values[one.name] = old[one.name].copy()
                values[one.name][rows[mask]] = new[one.name][mask]
        if len(self.sensors):  # they also carry images outside of the selection
            changed = (values["sensor_from_rig"] != whole.sensor_from_rig).any(axis=1)
            sensor = whole.image_sensor
            stale = (sensor >= 0) & changed[sensor]
            stale[self.images if images is None else self.images[images]] = False
            moved = np.flatnonzero(stale)
            of_rigs = {"image_frame": whole.image_frame, "image_sensor": sensor, **values}
            values["cam_from_world"][moved] = rig_arrays.placed(of_rigs)[moved]
        return with_estimates(whole, values, checked=True)


def select(
    whole: P,
    *,
    images: ArrayLike | None = None,
    cameras: ArrayLike | None = None,
    points: ArrayLike | None = None,
    observations: ArrayLike | None = None,
) -> Selection[P]:
    """Select rows of a problem; see :meth:`bundle.Problem.select`."""
    of_images = _mask("images", images, whole.num_images)
    of_cameras = _mask("cameras", cameras, whole.num_cameras)
    of_points = _mask("points", points, whole.num_points)
    seen = _mask("observations", observations, whole.num_observations)
    for mask, of in ((of_images, whole.observation_image), (of_points, whole.observation_point)):
        if mask is not None:
            seen = mask.take(of) if seen is None else seen & mask.take(of)
    state: dict[str, Any] = {}
    chosen: dict[str, _Indices] = {
        "images": _rows(of_images, whole.num_images),
        "cameras": _rows(of_cameras, whole.num_cameras),
        "points": _rows(of_points, whole.num_points),
        "observations": _rows(seen, whole.num_observations),
        "frames": np.arange(whole.num_frames),
        "sensors": np.arange(whole.num_sensors),
    }

    def take(rows: _Indices, *names: str) -> None:
        for name in names:
            state[name] = freeze(getattr(whole, name).take(rows, axis=0))

    def renumber(name: str, rows: _Indices, count: int) -> None:
        """Replace indices in the original problem by indices in the selection; -1 stays."""
        place = np.full(count + 1, -1, np.int32)
        place[rows] = np.arange(len(rows), dtype=np.int32)
        state[name] = freeze(place.take(state.get(name, getattr(whole, name))))

    if seen is not None:
        rows = chosen["observations"]
        take(rows, *(f"observation_{name}" for name in ("image", "point", "xy", "keypoint")))
        if whole.observation_sigma is not None:
            sigma = whole.observation_sigma.take(rows)
            state["observation_sigma"] = freeze(sigma) if len(rows) else None
    if of_points is not None:
        take(chosen["points"], *arrays_of("points"), "point_ids")
        renumber("observation_point", chosen["points"], whole.num_points)
    if of_images is not None:
        rows = chosen["images"]
        take(rows, *arrays_of("images"), "image_ids", "image_camera")
        state["image_names"] = tuple(whole.image_names[row] for row in rows.tolist())
        renumber("observation_image", rows, whole.num_images)
        if whole.num_frames:
            take(rows, "image_frame", "image_sensor")
            those = whole.image_frame[rows]
            frames = distinct(those[those >= 0]).astype(np.int64)
            rigs = whole.frame_rig_ids[frames]
            sensors = np.flatnonzero(np.isin(whole.sensor_rig_ids, rigs))
            chosen |= {"frames": frames, "sensors": sensors}
            take(frames, *arrays_of("frames"), "frame_ids", "frame_rig_ids")
            take(sensors, *arrays_of("sensors"), "sensor_rig_ids", "sensor_camera_ids")
            renumber("image_frame", frames, whole.num_frames)
            renumber("image_sensor", sensors, whole.num_sensors)
            if not len(frames):
                nothing = filled((0,), 0, np.int32)
                state |= {"image_frame": nothing, "image_sensor": nothing}
    if of_cameras is not None:
        rows = chosen["cameras"]
        take(rows, *arrays_of("cameras"), "camera_ids", "camera_sizes")
        state["camera_models"] = tuple(whole.camera_models[row] for row in rows.tolist())
        renumber("image_camera", rows, whole.num_cameras)
        refuse_row(
            state["image_camera"] < 0,
            lambda k: (
                "cameras: expected the camera of each selected image, that of image "
                f"{whole.image_ids[chosen['images'][k]]} is missing"
            ),
        )
    if of_images is not None or of_cameras is not None:
        shutter: RollingShutter | None = whole.rolling_shutter
        if shutter is not None:
            state["rolling_shutter"] = selected(shutter, chosen["images"], chosen["cameras"])
        count = len(chosen["observations"])
        state |= {"source": None, "observation_keypoint": filled((count,), -1, np.int32)}
    return Selection(whole._moved(**state) if state else whole, **chosen)


def with_frames(problem: ProblemArrays, images: _Mask) -> _Mask:
    """Return a mask of the given images and of all images that share a frame with one of them."""
    if not problem.num_frames:
        return images
    frames = problem.image_frame[images]
    return images | np.isin(problem.image_frame, frames[frames >= 0])


def _mask(name: str, given: ArrayLike | None, count: int) -> _Mask | None:
    """Return rows as a mask; None: all of them."""
    if given is None:
        return None
    rows = np.asarray(given)
    if rows.dtype == bool:
        if rows.shape != (count,):
            raise InputError(f"{name}: expected a mask of shape ({count},), found {rows.shape}")
        mask = rows
    else:
        if rows.size and not (rows.ndim == 1 and np.issubdtype(rows.dtype, np.integer)):
            raise InputError(f"{name}: expected a mask or indices, found {brief(given)}")
        rows = rows.astype(np.int64)
        refuse_row(
            (rows < 0) | (rows >= count),
            lambda k: f"{name}: expected indices from 0 to {count - 1}, found {rows[k]}",
        )
        mask = np.zeros(count, bool)
        mask[rows] = True
    return None if mask.all() else mask


def _rows(mask: _Mask | None, count: int) -> _Indices:
    return np.arange(count) if mask is None else np.flatnonzero(mask)
