"""The problem: cameras, images, points and observations as read-only NumPy arrays.

Conventions are COLMAP's. A point ``X`` of the world appears in the frame of image ``i`` as
``R(q) X + t`` with ``cam_from_world[i] = (qx, qy, qz, qw, tx, ty, tz)``: x right, y down, z
forward; the centre of the upper left pixel is (0.5, 0.5).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.display import Display, Displayed
from bundle.errors import InputError
from bundle.words import contents, format_name

if TYPE_CHECKING:
    import pycolmap

__all__ = ["Problem"]

_DTYPES: dict[str, type] = {
    "cam_from_world": np.float64,
    "image_ids": np.int64,
    "image_camera": np.int32,
    "camera_ids": np.int64,
    "camera_params": np.float64,
    "camera_sizes": np.int64,
    "points": np.float64,
    "point_ids": np.int64,
    "observation_image": np.int32,
    "observation_point": np.int32,
    "observation_xy": np.float64,
    "observation_keypoint": np.int32,
}


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Problem(Displayed):
    """A bundle adjustment problem.

    Arrays are C-contiguous and read-only; an array of the right type is taken as it is, without a
    copy, and made read-only through a view. Only registered images are in a problem: what a
    reconstruction holds besides stays in ``source`` and is written back by ``bundle.save``.

    Attributes:
        cam_from_world: (num_images, 7) pose of each image, qx qy qz qw tx ty tz, translation in the
            reconstruction's length unit. The quaternion need not be exactly normalised.
        image_ids: (num_images,) ids in the source; BAL numbers from 0.
        image_names: num_images names; "" where the source has none.
        image_camera: (num_images,) index (not id) of each image's camera.
        camera_ids: (num_cameras,) ids in the source.
        camera_models: num_cameras COLMAP model names.
        camera_params: (num_cameras, width) parameters in COLMAP's order (pixels for focal lengths
            and principal point), rows padded with zeros to the longest model.
        camera_sizes: (num_cameras, 2) image width and height in pixels, 0 where unknown.
        points: (num_points, 3) world coordinates in the reconstruction's length unit.
        point_ids: (num_points,) ids in the source.
        observation_image: (num_observations,) image index of each observation.
        observation_point: (num_observations,) point index of each observation.
        observation_xy: (num_observations, 2) measured position in pixels.
        observation_keypoint: (num_observations,) index of the observation among the keypoints of
            its image in the source; -1 where the source has no keypoints.
        format: "bal", "colmap" or "memory": where it came from. Decides the defaults of ``gauge``
            and ``cheirality`` and what ``bundle.save`` writes when the path does not say.
        source: what was read, kept so that writing back loses nothing (a pycolmap.Reconstruction
            for COLMAP models). Never changed.

    Raises:
        InputError: an array has the wrong shape, holds a value that is not finite, an index out of
            range, a repeated id, a zero quaternion or a focal length that is not positive. The
            message names the image, camera, point or observation.
    """

    cam_from_world: NDArray[np.float64]
    image_ids: NDArray[np.int64]
    image_names: tuple[str, ...]
    image_camera: NDArray[np.int32]
    camera_ids: NDArray[np.int64]
    camera_models: tuple[str, ...]
    camera_params: NDArray[np.float64]
    camera_sizes: NDArray[np.int64]
    points: NDArray[np.float64]
    point_ids: NDArray[np.int64]
    observation_image: NDArray[np.int32]
    observation_point: NDArray[np.int32]
    observation_xy: NDArray[np.float64]
    observation_keypoint: NDArray[np.int32]
    format: str = "memory"
    source: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name, dtype in _DTYPES.items():
            array = _as_array(name, getattr(self, name), dtype).view()
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        object.__setattr__(self, "image_names", tuple(self.image_names))
        object.__setattr__(self, "camera_models", tuple(self.camera_models))
        _core.validate(self)

    @property
    def num_images(self) -> int:
        """Number of registered images."""
        return len(self.cam_from_world)

    @property
    def num_cameras(self) -> int:
        """Number of cameras, used by an image or not."""
        return len(self.camera_params)

    @property
    def num_points(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def num_observations(self) -> int:
        """Number of observations."""
        return len(self.observation_xy)

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some arrays replaced; the others are shared, not copied."""
        return dataclasses.replace(self, **changes)

    @staticmethod
    def from_pycolmap(reconstruction: pycolmap.Reconstruction) -> Problem:
        """Take over the registered images of a reconstruction, which is copied and kept as source.

        Raises:
            InputError: the reconstruction has a rig of several sensors, or references that do not
                resolve.
        """
        from bundle.io import colmap

        return colmap.from_pycolmap(reconstruction)

    def to_pycolmap(self) -> pycolmap.Reconstruction:
        """Return a reconstruction: a copy of the source with the numbers of this problem in it.

        Per-point errors are recomputed. A problem that did not come from COLMAP gives a new
        reconstruction with one trivial rig and frame an image.
        """
        from bundle.io import colmap

        return colmap.to_pycolmap(self)

    def __repr__(self) -> str:
        return f"Problem({self.format}: {contents(self)})"

    def _display(self) -> Display:
        models = ", ".join(dict.fromkeys(self.camera_models)) or "none"
        return Display(
            title=f"Problem ({format_name(self.format)})",
            facts=(("contents", contents(self)), ("camera models", models)),
        )


def _as_array(name: str, value: Any, dtype: type) -> NDArray[Any]:
    """Return the value as a contiguous array of the type; itself where it is one already."""
    try:
        given = np.asarray(value)
        array: NDArray[Any] = np.ascontiguousarray(given, dtype=dtype)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name}: expected numbers, found {type(value).__name__}") from None
    if np.issubdtype(dtype, np.integer) and given.dtype != array.dtype and (given != array).any():
        raise InputError(f"{name}: expected whole numbers of {array.dtype}, found others")
    return array
