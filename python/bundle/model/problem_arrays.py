"""The arrays of a problem as a protocol.

:class:`bundle.Problem` documents each array. The modules that it imports (defaults of fields, rigs,
records of COLMAP's files) use this protocol instead of the class.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

_Doubles = NDArray[np.float64]
_Ids = NDArray[np.int64]
_Rows = NDArray[np.int32]


class ProblemArrays(Protocol):
    """The fields of a :class:`bundle.Problem` and their counts."""

    @property
    def cam_from_world(self) -> _Doubles: ...  # noqa: D102
    @property
    def image_ids(self) -> _Ids: ...  # noqa: D102
    @property
    def image_names(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def image_camera(self) -> _Rows: ...  # noqa: D102
    @property
    def camera_ids(self) -> _Ids: ...  # noqa: D102
    @property
    def camera_models(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def camera_params(self) -> _Doubles: ...  # noqa: D102
    @property
    def camera_sizes(self) -> _Ids: ...  # noqa: D102
    @property
    def points(self) -> _Doubles: ...  # noqa: D102
    @property
    def point_ids(self) -> _Ids: ...  # noqa: D102
    @property
    def observation_image(self) -> _Rows: ...  # noqa: D102
    @property
    def observation_point(self) -> _Rows: ...  # noqa: D102
    @property
    def observation_xy(self) -> _Doubles: ...  # noqa: D102
    @property
    def observation_keypoint(self) -> _Rows: ...  # noqa: D102
    @property
    def rig_from_world(self) -> _Doubles: ...  # noqa: D102
    @property
    def frame_ids(self) -> _Ids: ...  # noqa: D102
    @property
    def frame_rig_ids(self) -> _Ids: ...  # noqa: D102
    @property
    def image_frame(self) -> _Rows: ...  # noqa: D102
    @property
    def image_sensor(self) -> _Rows: ...  # noqa: D102
    @property
    def sensor_from_rig(self) -> _Doubles: ...  # noqa: D102
    @property
    def sensor_rig_ids(self) -> _Ids: ...  # noqa: D102
    @property
    def sensor_camera_ids(self) -> _Ids: ...  # noqa: D102
    @property
    def num_images(self) -> int: ...  # noqa: D102
    @property
    def num_cameras(self) -> int: ...  # noqa: D102
    @property
    def num_points(self) -> int: ...  # noqa: D102
    @property
    def num_observations(self) -> int: ...  # noqa: D102
    @property
    def num_frames(self) -> int: ...  # noqa: D102
    @property
    def num_sensors(self) -> int: ...  # noqa: D102

    def check_padding(self) -> None:
        """Raise an InputError for nonzero padding in ``camera_params``."""
