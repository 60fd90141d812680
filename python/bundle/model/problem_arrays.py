"""The arrays of a problem and their counts: the base of :class:`bundle.Problem`.

The modules that the class imports (defaults of fields, rigs, records of COLMAP's files) use this
base instead.
"""

from __future__ import annotations

import dataclasses
from dataclasses import field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.model.cameras import camera_models


def _by_default() -> Any:
    """Return None, a placeholder for the default until the number of images is known."""
    return None


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ProblemArrays:
    """The arrays of a problem, which :class:`bundle.Problem` documents, and their counts."""

    cam_from_world: NDArray[np.float64]
    image_ids: NDArray[np.int64] = field(default_factory=_by_default)
    image_names: tuple[str, ...] = field(default_factory=_by_default)
    image_camera: NDArray[np.int32] = field(default_factory=_by_default)
    camera_ids: NDArray[np.int64] = field(default_factory=_by_default)
    camera_models: tuple[str, ...]
    camera_params: NDArray[np.float64]
    camera_sizes: NDArray[np.int64] = field(default_factory=_by_default)
    points: NDArray[np.float64]
    point_ids: NDArray[np.int64] = field(default_factory=_by_default)
    observation_image: NDArray[np.int32]
    observation_point: NDArray[np.int32]
    observation_xy: NDArray[np.float64]
    observation_keypoint: NDArray[np.int32] = field(default_factory=_by_default)
    observation_sigma: NDArray[np.float64] | None = None
    rig_from_world: NDArray[np.float64] = field(default_factory=_by_default)
    frame_ids: NDArray[np.int64] = field(default_factory=_by_default)
    frame_rig_ids: NDArray[np.int64] = field(default_factory=_by_default)
    image_frame: NDArray[np.int32] = field(default_factory=_by_default)
    image_sensor: NDArray[np.int32] = field(default_factory=_by_default)
    sensor_from_rig: NDArray[np.float64] = field(default_factory=_by_default)
    sensor_rig_ids: NDArray[np.int64] = field(default_factory=_by_default)
    sensor_camera_ids: NDArray[np.int64] = field(default_factory=_by_default)
    rolling_shutter: Any = None

    @property
    def num_images(self) -> int:
        """Number of registered images."""
        return len(self.cam_from_world)

    @property
    def num_cameras(self) -> int:
        """Number of cameras, with or without an image."""
        return len(self.camera_params)

    @property
    def num_points(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def num_observations(self) -> int:
        """Number of observations."""
        return len(self.observation_xy)

    @property
    def num_frames(self) -> int:
        """Number of frames of rigs with several sensors."""
        return len(self.rig_from_world)

    @property
    def num_sensors(self) -> int:
        """Number of sensors with a sensor_from_rig; reference sensors are not included."""
        return len(self.sensor_from_rig)

    def check_padding(self) -> None:
        """Raise an InputError for nonzero padding in ``camera_params``, which no file can store.

        Such numbers remain if a camera model was replaced by one with fewer parameters.
        """
        models = camera_models()
        lengths = np.array([len(models[name]) for name in self.camera_models], dtype=np.int64)
        width = self.camera_params.shape[1]
        beyond = (np.arange(width) >= lengths[:, None]) & (self.camera_params != 0)
        if beyond.any():
            camera, column = np.argwhere(beyond)[0]
            raise InputError(
                f"camera_params: camera {self.camera_ids[camera]}: expected zeros after the "
                f"{lengths[camera]} parameters of {self.camera_models[camera]}, "
                f"found {self.camera_params[camera, column]:g}"
            )

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some fields replaced."""
        return dataclasses.replace(self, **changes)

    def _moved(self, **state: Any) -> Self:
        """Return a copy with other arrays, which must be immutable and valid."""
        moved = object.__new__(type(self))
        vars(moved).update(vars(self), **state)
        return moved
