"""The problem: cameras, images, points and observations as read-only NumPy arrays.

Conventions are COLMAP's. A world point ``X`` has the coordinates ``R(q) X + t`` in the camera frame
of image ``i``. The pose is ``cam_from_world[i] = (qx, qy, qz, qw, tx, ty, tz)``. In the camera
frame, x is right, y down, z forward. The centre of the upper left pixel is (0.5, 0.5).
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import field
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import (
    Array,
    Index,
    declare,
    default_of,
    distinct,
    filled,
    immutable,
    refuse_row,
)
from bundle.base.display import Display, Displayed
from bundle.base.optional_packages import require_pycolmap
from bundle.base.records import dataclass
from bundle.base.words import FORMATS, contents, format_name, plural
from bundle.errors import InputError
from bundle.interface.option_fields import choice
from bundle.model import rig_arrays, rolling_shutter
from bundle.model.cameras import camera_models
from bundle.model.problem_arrays import ProblemArrays
from bundle.model.pycolmap.problem_source import DeferredSource, packed, unpacked
from bundle.model.selection import select

if TYPE_CHECKING:
    import pandas
    import pycolmap

    from bundle.model.rolling_shutter import RollingShutter
    from bundle.model.selection import Selection


# Arrays of a problem: their declarations and defaults, and the checks that are not in the core.
#
# The core checks shapes, numbers and indices of all arrays in one pass (``_core.validate``).


# Fields without a default come first, because the defaults of others depend on their lengths.
ARRAYS = declare(
    cam_from_world=Array(("num_images", 7), "pose"),
    camera_params=Array(("num_cameras", "width"), "finite"),
    points=Array(("num_points", 3), "finite"),
    observation_image=Array(("num_observations",), Index("num_images"), np.int32),
    observation_point=Array(("num_observations",), Index("num_points"), np.int32),
    observation_xy=Array(("num_observations", 2), "finite"),
    observation_keypoint=Array(("num_observations",), dtype=np.int32, default=-1),
    image_ids=Array(("num_images",), dtype=np.int64, default="range"),
    image_camera=Array(("num_images",), Index("num_cameras"), np.int32, default="range"),
    camera_ids=Array(("num_cameras",), dtype=np.int64, default="range"),
    camera_sizes=Array(("num_cameras", 2), "at least 0", np.int64, default=0),
    point_ids=Array(("num_points",), dtype=np.int64, default="range"),
    **rig_arrays.ARRAYS,
)


def default(problem: ProblemArrays, name: str) -> NDArray[Any]:
    """Return the default of an array; the arrays on which it depends must be set."""
    if name in rig_arrays.ARRAYS:
        return rig_arrays.default(problem, name)
    declared = ARRAYS[name]
    if declared.default == "required":
        raise InputError(f"{name}: expected numbers, found None")
    count = getattr(problem, str(declared.shape[0]))
    if name == "image_camera" and problem.num_cameras != count:
        if problem.num_cameras != 1:
            raise InputError(
                "image_camera: expected the index of each image's camera, because there are "
                f"{count} images and {problem.num_cameras} cameras, found None"
            )
        return filled((count,), 0, declared.dtype)
    return default_of(declared, {declared.shape[0]: count})


def sigmas_or_none(given: Any) -> NDArray[np.float64] | None:
    """Convert the sigmas of observations; return None for None or an empty array."""
    if given is None:
        return None
    sigmas = immutable("observation_sigma", given, np.float64)
    return sigmas if sigmas.size else None


def strings(field_name: str, names: Any) -> tuple[str, ...]:
    """Return names as a tuple of plain strings; the core checks their characters."""
    if isinstance(names, (str, bytes)):
        raise InputError(f"{field_name}: expected a sequence of strings, found a single string")
    try:
        found = tuple(names)
    except TypeError:
        raise InputError(
            f"{field_name}: expected a sequence of strings, found {type(names).__name__}"
        ) from None
    for index, name in enumerate(found):
        if not isinstance(name, str):
            raise InputError(
                f"{field_name}: expected strings, found {type(name).__name__} at index {index}"
            )
    return tuple(map(str, found))


def check_values(problem: ProblemArrays) -> None:
    """Check the values that the core does not check."""
    refuse_row(
        (problem.camera_sizes < 0).any(axis=1),
        lambda k: (
            f"camera_sizes: camera {problem.camera_ids[k]}: expected a width and a height of at "
            f"least 0, found {' x '.join(map(str, problem.camera_sizes[k].tolist()))}"
        ),
    )
    refuse_row(
        problem.observation_keypoint < -1,
        lambda k: (
            f"observation_keypoint: observation {k}: expected a keypoint index, or -1 without a "
            f"keypoint, found {problem.observation_keypoint[k]}"
        ),
    )


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Problem(ProblemArrays, Displayed):
    """A bundle adjustment problem.

    Poses, camera models and parameters, points and observations are required; all other fields have
    defaults. Arrays are C-contiguous and immutable. Immutable arrays, such as arrays of another
    problem, are shared; other arrays are copied.

    A problem has registered images only. Other records of a reconstruction stay in ``source`` and
    are written back by ``bundle.save``. To edit a problem, create a new one with
    ``dataclasses.replace`` or :meth:`replace`. ``bundle.save`` writes every edit, raises an error,
    or returns a sentence on information that the format cannot hold.

    Attributes:
        cam_from_world: (num_images, 7) pose of each image, qx qy qz qw tx ty tz, translation in the
            reconstruction's length unit. The quaternion need not be exactly normalised.
        image_ids: (num_images,) ids in the source; from 0 by default, as in BAL.
        image_names: num_images names; "" (the default) for an image without a name in the source.
        image_camera: (num_images,) index (not id) of each image's camera. By default image i has
            camera i; if the problem has one camera, all images have it.
        rig_from_world: (num_frames, 7) pose of each frame of rigs with several sensors, in the
            layout of cam_from_world; empty (the default) if every image has its own pose.
        frame_ids: (num_frames,) ids in the source; from 0 by default.
        frame_rig_ids: (num_frames,) rig id of each frame; by default the rig id of its sensors.
        image_frame: (num_images,) index (not id) of each image's frame; -1 for an image with its
            own pose; empty (the default) if the problem has no frames.
        image_sensor: (num_images,) index of each image's sensor; -1 for the reference sensor of its
            rig and for images without a frame; empty (the default) if the problem has no frames.
        sensor_from_rig: (num_sensors, 7) pose of each camera on its rig, in the layout of
            cam_from_world with the rig in place of the world. Reference sensors are left out: their
            pose is the rig's. An image with a frame has cam_from_world = sensor_from_rig *
            rig_from_world. The tolerance is 1e-6 in each entry of the rotation, and 1e-6 of the
            larger of the two translations.
        sensor_rig_ids: (num_sensors,) rig id of each sensor in the source.
        sensor_camera_ids: (num_sensors,) camera id (not index) of each sensor.
        camera_ids: (num_cameras,) ids in the source; from 0 by default.
        camera_models: num_cameras COLMAP model names; see ``bundle.camera_models()``.
        camera_params: (num_cameras, width) parameters in COLMAP's order (pixels for focal lengths
            and principal point), rows padded with zeros to the longest model.
        camera_sizes: (num_cameras, 2) image width and height in pixels; 0 (the default) if unknown.
        points: (num_points, 3) world coordinates in the reconstruction's length unit.
        point_ids: (num_points,) ids in the source; from 0 by default.
        observation_image: (num_observations,) image index (not id) of each observation.
        observation_point: (num_observations,) point index (not id) of each observation.
        observation_xy: (num_observations, 2) measured position in pixels, x right, y down. The
            origin is the upper left corner of the upper left pixel (BAL: the principal point).
        observation_keypoint: (num_observations,) index of the observation among the keypoints of
            its image in the source; -1 (the default) if the source has no such keypoint.
        observation_sigma: (num_observations,) standard deviation of each measured position, in
            pixels; None (the default) means 1 for all. A solve divides the residual r by sigma
            before it applies the loss: the cost is 1/2 sum rho(||r / sigma||^2), and ``loss_scale``
            is in sigmas. Statistics of reprojection errors stay in pixels. No file format stores
            sigmas.
        rolling_shutter: shutters that read images row by row, and the motion of each image
            meanwhile; None (the default): all shutters are global.
        format: "bal", "colmap" or "memory" (the default): origin of the problem. It determines the
            defaults of ``gauge`` and, with the camera models, of ``cheirality``. It is also the
            output format of ``bundle.save`` if the path does not decide it.
        source: the data that was read, kept for writing without loss: a pycolmap.Reconstruction for
            COLMAP models, the rotations of the file for BAL, None (the default) for problems from
            memory. It is never modified.

    Raises:
        InputError: an array has the wrong shape or type, holds a value that is not finite, an index
            out of range, a repeated id, a zero quaternion, a focal length that is not positive or a
            negative size; a name has characters that cannot be printed; a camera model does not
            exist; the pose of an image differs from that of its rig. The message names the field,
            or the image, camera, point, observation, frame or sensor.
    """

    rolling_shutter: RollingShutter | None = None
    format: str = "memory"
    source: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "format", choice("format", self.format, (*FORMATS, "memory")))
        for name, one in ARRAYS.items():
            value = getattr(self, name)
            array = default(self, name) if value is None else immutable(name, value, one.dtype)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "observation_sigma", sigmas_or_none(self.observation_sigma))
        names = ("",) * self.num_images if self.image_names is None else self.image_names
        object.__setattr__(self, "image_names", strings("image_names", names))
        models = strings("camera_models", self.camera_models)
        known = camera_models()
        canonical = {
            model: choice("camera_models", model, known) for model in dict.fromkeys(models)
        }
        object.__setattr__(self, "camera_models", tuple(canonical[model] for model in models))
        rig_arrays.settle(self)
        rolling_shutter.check_counts(self, self.rolling_shutter)
        _core.validate(self)
        check_values(self)
        rig_arrays.check(self)
        rolling_shutter.check(self, self.rolling_shutter)

    @property
    def num_rigs(self) -> int:
        """Number of rigs with several sensors and at least one frame."""
        return len(distinct(self.frame_rig_ids))

    @property
    def projection_centers(self) -> NDArray[np.float64]:
        """(num_images, 3) camera positions -R(q)^T t in the world, in its length unit."""
        axis, w = -self.cam_from_world[:, :3], self.cam_from_world[:, 3:4]
        back = -self.cam_from_world[:, 4:]
        # Rotate by the conjugate: v + 2 w (u x v) + 2 u x (u x v) for a quaternion of norm 1.
        scale = 2 / (self.cam_from_world[:, :4] ** 2).sum(axis=1, keepdims=True)
        cross = np.cross(axis, back)
        centers: NDArray[np.float64] = back + scale * (w * cross + np.cross(axis, cross))
        return centers

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return dataclasses.replace(self, source=copy.deepcopy(vars(self)["source"], memo))

    def __reduce__(self) -> tuple[Any, ...]:
        fields = {field.name: vars(self)[field.name] for field in dataclasses.fields(self)}
        return _unpacked, (type(self), fields | {"source": packed(fields["source"])})

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some arrays replaced; the others are shared, not copied.

        If frames or sensors of rigs change and ``cam_from_world`` is not given, it is recomputed
        for the images that move. A ``cam_from_world`` that contradicts the rigs raises an error. To
        move images of rigs, replace ``rig_from_world`` or ``sensor_from_rig``.
        """
        poses = rig_arrays.recomputed_poses(self, changes)
        if poses is not None:
            changes["cam_from_world"] = poses
        return super().replace(**{"source": vars(self)["source"], **changes})

    def select(
        self,
        *,
        images: ArrayLike | None = None,
        cameras: ArrayLike | None = None,
        points: ArrayLike | None = None,
        observations: ArrayLike | None = None,
    ) -> Selection[Self]:
        """Return a sub-problem with some images, cameras, points and observations.

        The result can also put refined values back into this problem. An observation is selected if
        its own mask, its image and its point are selected.

        Args:
            images: mask, or indices in any order; None: all.
            cameras: as ``images``, for cameras; must include the cameras of the selected images.
            points: as ``images``, for points.
            observations: as ``images``, for observations.

        Raises:
            InputError: an argument is neither a mask nor indices, or the camera of a selected image
                is missing.

        Example:
            >>> near = problem.select(points=problem.points[:, 2] < 10)
            >>> problem = near.put_back(problem, bundle.solve(near.problem).problem)
        """
        return select(
            self, images=images, cameras=cameras, points=points, observations=observations
        )

    def without_rigs(self) -> Self:
        """Return a copy without rigs in which each image has its own pose, with the same value."""
        return self.replace(**dict.fromkeys(rig_arrays.ARRAYS))

    @staticmethod
    def from_pycolmap(reconstruction: pycolmap.Reconstruction) -> Problem:
        """Make a problem from the registered images of a reconstruction; keep a copy as source.

        Raises:
            InputError: a camera with images has no sensor_from_rig, or references are invalid.
        """
        require_pycolmap("Problem.from_pycolmap")
        from bundle.model.pycolmap.reconstruction import fields_of

        return Problem(**fields_of(reconstruction))

    def to_pycolmap(self) -> pycolmap.Reconstruction:
        """Return a reconstruction: a copy of the source with the values of this problem.

        The errors of points are recomputed; ``observation_sigma`` is lost. A problem that does not
        come from COLMAP gives a new reconstruction. In it, each image without a rig gets a trivial
        rig and frame.
        """
        require_pycolmap("Problem.to_pycolmap")
        from bundle.model.pycolmap.reconstruction import to_pycolmap

        return to_pycolmap(self)

    def to_dataframe(self, table: str = "observations") -> pandas.DataFrame:
        """Return a table as a pandas.DataFrame; pandas is the extra ``tables``.

        Args:
            table: "observations" (ids, position, residual in pixels), "points" (coordinates,
                number of observations, errors), "images" (pose, centre, errors) or "cameras"
                (parameters, errors).

        Raises:
            InputError: the table is unknown, or pandas is not installed.

        Example:
            >>> problem.to_dataframe("images").sort_values("rmse").to_csv("images.csv")
        """
        from bundle.interface.tabular import frame_of  # late: most programs use no tables

        return frame_of(TABLES[choice("table", table, tuple(TABLES))](self))

    def __repr__(self) -> str:
        return f"Problem({self.format}: {contents(self)}{self._rigs(', ')})"

    def _rigs(self, before: str = "") -> str:
        """Return "26 frames of 1 rig", or "" without rigs."""
        if not self.num_frames:
            return ""
        return f"{before}{plural(self.num_frames, 'frame')} of {plural(self.num_rigs, 'rig')}"

    def _display(self) -> Display:
        models = ", ".join(dict.fromkeys(self.camera_models)) or "none"
        return Display(
            title=f"Problem ({format_name(self.format)})",
            facts=(
                ("contents", contents(self)),
                ("camera models", models),
                *((("rigs", self._rigs()),) if self.num_frames else ()),
            ),
        )


class _Source:
    """Descriptor of the field ``source``; converts it to a reconstruction on first access."""

    def __get__(self, problem: Problem | None, owner: type[Problem]) -> Any:
        if problem is None:
            return None
        source = vars(problem)["source"]
        return source.reconstruction() if isinstance(source, DeferredSource) else source

    def __set__(self, problem: Problem, source: Any) -> None:
        vars(problem)["source"] = source


setattr(Problem, "source", _Source())  # noqa: B010 (the checker knows the field)


def _unpacked(cls: type[Problem], fields: dict[str, Any]) -> Problem:
    """Return a problem from a pickle, checked again: the file may have changed."""
    return cls(**fields | {"source": unpacked(fields["source"])})


# Tables of a problem as columns: cameras, images, points and observations with residuals.
#
# Columns are NumPy arrays by name; a problem is a :class:`bundle.Problem`. ``frame_of`` of
# ``bundle.interface.tabular`` makes a pandas.DataFrame of them.

Columns = dict[str, Any]
_POSE = ("qx", "qy", "qz", "qw", "tx", "ty", "tz")


def _observations(problem: Any) -> Columns:
    """Return one row per observation: ids, measured position, residual and its length in pixels."""
    image, point = problem.observation_image, problem.observation_point
    residual, behind = _core.reprojection_residuals(problem, 0, "auto")
    return {
        "image_id": problem.image_ids[image],
        "point_id": problem.point_ids[point],
        "camera_id": problem.camera_ids[problem.image_camera[image]],
        "keypoint": problem.observation_keypoint,
        **_parts("", "xy", problem.observation_xy),
        **_parts("residual_", "xy", residual),
        "error": np.hypot(residual[:, 0], residual[:, 1]),
        "is_behind": behind,
        **({} if problem.observation_sigma is None else {"sigma": problem.observation_sigma}),
    }


def _points(problem: Any) -> Columns:
    """Return one row per point: id, coordinates, number of views, mean and largest error."""
    return {
        "point_id": problem.point_ids,
        **_parts("", "xyz", problem.points),
        **_errors(problem, problem.observation_point, problem.num_points),
    }


def _images(problem: Any) -> Columns:
    """Return one row per image: id, name, camera, pose, centre, number of points, errors."""
    return {
        "image_id": problem.image_ids,
        "name": list(problem.image_names),
        "camera_id": problem.camera_ids[problem.image_camera],
        **dict(zip(_POSE, problem.cam_from_world.T, strict=True)),
        **_parts("center_", "xyz", problem.projection_centers),
        **_errors(problem, problem.observation_image, problem.num_images),
    }


def _cameras(problem: Any) -> Columns:
    """Return one row per camera: id, model, size, parameters by name (NaN where it has none)."""
    models = camera_models()
    names = list(dict.fromkeys(name for model in problem.camera_models for name in models[model]))
    params = {name: np.full(problem.num_cameras, np.nan) for name in names}
    for camera, model in enumerate(problem.camera_models):
        for column, name in enumerate(models[model]):
            params[name][camera] = problem.camera_params[camera, column]
    used = problem.image_camera
    return {
        "camera_id": problem.camera_ids,
        "model": list(problem.camera_models),
        "width": problem.camera_sizes[:, 0],
        "height": problem.camera_sizes[:, 1],
        "num_images": np.bincount(used, minlength=problem.num_cameras),
        **params,
        **_errors(problem, used[problem.observation_image], problem.num_cameras),
    }


def _errors(problem: Any, owner: NDArray[Any], count: int) -> Columns:
    """Return the number of observations, and the mean square and largest error, of each owner."""
    errors, _ = _core.reprojection_errors(problem, 0, "auto")
    known = np.isfinite(errors)
    squares = np.bincount(owner[known], errors[known] ** 2, count)
    number = np.bincount(owner[known], minlength=count)
    largest = np.full(count, -np.inf)
    np.maximum.at(largest, owner[known], errors[known])
    return {
        "num_observations": np.bincount(owner, minlength=count),
        "rmse": np.where(number > 0, np.sqrt(squares / np.maximum(number, 1)), np.nan),
        "max_error": np.where(number > 0, largest, np.nan),
    }


def _parts(before: str, axes: str, values: NDArray[Any]) -> Columns:
    return {f"{before}{axis}": values[:, column] for column, axis in enumerate(axes)}


TABLES: Mapping[str, Callable[[Any], Columns]] = {
    "observations": _observations,
    "points": _points,
    "images": _images,
    "cameras": _cameras,
}
"""Functions that return the columns of each table."""
