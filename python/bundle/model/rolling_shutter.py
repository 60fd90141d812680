"""Rolling shutters: cameras that read an image row by row, or column by column, while they move.

An image i of a camera with a rolling shutter has one twist m = (w, v), which is constant during its
readout. A world point X that the image sees at the pixel (x, y) has the camera coordinates

    Exp(s m) T X,    s = y / height - 1/2  (columns: x / width - 1/2),

where T is the image's ``cam_from_world``, the pose of the middle row, and Exp the exponential of
SE(3). So m is the motion during the readout of one frame height, in the camera's frame. It is the
readout, as a share of the time between two frames, times the motion between two frames.
``cpp/core/factors/rolling_shutter.h`` has the residual and its derivatives.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import (
    Array,
    FrozenArrays,
    Index,
    check_arrays,
    check_type,
    declare,
    freeze,
    refuse_row,
)
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.interface.option_fields import choice, number
from bundle.model.problem_arrays import ProblemArrays


def _unknown() -> Any:
    """Return None, a placeholder for unknown readouts until the number of cameras is known."""
    return None


DIRECTIONS = ("global", "rows", "columns")
ROW_TIMES = ("fixed-point", "observed")


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class RollingShutter(FrozenArrays, Displayed):
    """The rolling shutters of a problem's cameras, and the twists of its images.

    Attributes:
        direction: one of "global", "rows" (from top to bottom) and "columns" (from left to right)
            per camera.
        readout: (num_cameras,) time from the first to the last row as a share of the time between
            two frames, above 0 and at most 1; NaN (the default) if unknown, and for global
            shutters. Twists tied to the neighbours' poses need it.
        twist: (num_images, 6) motion m = (wx, wy, wz, vx, vy, vz) per frame height in the camera's
            frame: radians and the reconstruction's length unit. Zero for global shutters.
        frames: (num_images,) time of each image in frames, NaN if unknown; None (the default) if
            no time is known.
        neighbours: (num_images, 2) index of the image before and after in the same video, between
            which an image's twist is constant; the image's own index at an end of the video, -1
            without neighbours; None (the default) if none are known.
        frame_rate: frames per second, NaN (the default) if unknown. Velocities need it.
        row_time: "fixed-point" (the default): a point's row is where the image sees it; "observed":
            that of the measurement, which biases twists by the noise of rows.
        axis: (num_cameras,) index in "global", "rows", "columns" of each camera's direction.

    Raises:
        InputError: an array has the wrong shape or type, or a value is impossible; the message
            names the field.
    """

    direction: tuple[str, ...]
    readout: NDArray[np.float64] = field(default_factory=_unknown)
    twist: NDArray[np.float64]
    frames: NDArray[np.float64] | None = None
    neighbours: NDArray[np.int32] | None = None
    frame_rate: float = math.nan
    row_time: str = "fixed-point"
    axis: NDArray[np.int8] = field(init=False)

    _ARRAYS = declare(
        readout=Array(("num_cameras",), "share or nan", default=math.nan),
        twist=Array(("num_images", 6), "finite"),
        frames=Array(("num_images",), "finite or nan", default="none"),
        neighbours=Array(("num_images", 2), Index("num_images", lowest=-1), np.int32, "none"),
    )

    def __post_init__(self) -> None:
        if isinstance(self.direction, str):
            raise InputError(
                "rolling_shutter: direction: expected one per camera, found a single string"
            )
        directions = tuple(
            choice("rolling_shutter: direction", one, DIRECTIONS) for one in self.direction
        )
        self._set("direction", directions)
        axis = [DIRECTIONS.index(one) for one in directions]
        self._set("axis", freeze(np.array(axis, np.int8)))
        check_arrays(self, self._ARRAYS, "rolling_shutter: ", num_cameras=len(directions))
        if self.neighbours is not None:
            known = self.neighbours
            refuse_row(
                (known < 0).any(axis=1) & (known >= 0).any(axis=1),
                lambda k: (
                    "rolling_shutter: neighbours: expected two images or twice -1, found "
                    f"{known[k].tolist()}"
                ),
            )
        if not (isinstance(self.frame_rate, float) and math.isnan(self.frame_rate)):
            rate = number("rolling_shutter: frame_rate", self.frame_rate, above=0)
            self._set("frame_rate", rate)
        self._set("row_time", choice("rolling_shutter: row_time", self.row_time, ROW_TIMES))

    def _set(self, attribute: str, value: Any) -> None:
        object.__setattr__(self, attribute, value)

    @property
    def is_rolling(self) -> NDArray[np.bool_]:
        """(num_cameras,) mask of the cameras with a rolling shutter."""
        return np.asarray(self.axis > 0)

    def tied(self, problem: ProblemArrays) -> NDArray[np.bool_]:
        """Return the mask of images with a rolling shutter and with neighbours."""
        if self.neighbours is None:
            return np.zeros(len(self.twist), bool)
        return np.asarray(self.is_rolling[problem.image_camera] & (self.neighbours[:, 0] >= 0))

    def check_tied(self, problem: ProblemArrays) -> None:
        """Check that twists can be tied to the poses of neighbours.

        Raises:
            InputError: no image has neighbours, or a time or a readout is unknown.
        """
        tied = self.tied(problem)
        if self.frames is None or self.neighbours is None or not tied.any():
            raise InputError(
                "twists: expected images with times and neighbours in the same video "
                "(RollingShutter.frames and neighbours; --frames), found 0 images with both"
            )
        apart = self.frames[self.neighbours[:, 1]] - self.frames[self.neighbours[:, 0]]
        refuse_row(
            tied & ~(apart > 0),
            lambda image: (
                f"rolling_shutter: image {problem.image_ids[image]}: expected neighbours in the "
                f"order of time, found {apart[image]:g} frames from one to the other"
            ),
        )
        refuse_row(
            tied & np.isnan(self.readout[problem.image_camera]),
            lambda image: (
                f"rolling_shutter: camera {problem.camera_ids[problem.image_camera[image]]}: "
                "expected a readout for tied twists, found an unknown one"
            ),
        )

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some fields replaced."""
        return dataclasses.replace(self, **changes)

    def _display(self) -> Display:
        rolling = int(self.is_rolling.sum())
        return Display(
            title="RollingShutter",
            facts=(
                ("cameras", f"{rolling} of {plural(len(self.direction), 'camera')}"),
                ("images", str(len(self.twist))),
            ),
        )


def check_counts(problem: ProblemArrays, shutter: Any) -> None:
    """Check that a rolling shutter has the cameras and images of the problem."""
    if shutter is None:
        return
    check_type("rolling_shutter", shutter, RollingShutter, "a bundle.RollingShutter or None")
    for what, expected, found in (
        ("cameras", len(problem.camera_params), len(shutter.direction)),
        ("images", len(problem.cam_from_world), len(shutter.twist)),
    ):
        if expected != found:
            raise InputError(
                f"rolling_shutter: expected the problem's {expected} {what}, found {found}"
            )


def check(problem: ProblemArrays, shutter: RollingShutter | None) -> None:
    """Check that a rolling shutter fits a problem whose arrays are valid."""
    if shutter is None:
        return
    rolls = shutter.is_rolling[problem.image_camera]
    sizes = problem.camera_sizes[problem.image_camera]
    axis = shutter.axis[problem.image_camera]
    length = np.where(axis == 2, sizes[:, 0], sizes[:, 1])
    refuse_row(
        rolls & (length <= 0),
        lambda image: (
            f"rolling_shutter: camera {problem.camera_ids[problem.image_camera[image]]}: expected "
            "the size of its images, which gives the time of a row, found size 0"
        ),
    )
    refuse_row(
        rolls & (problem.image_frame >= 0) if len(problem.image_frame) else (),
        lambda image: (
            f"rolling_shutter: image {problem.image_ids[image]}: expected an image with a pose of "
            "its own, found one of a rig, whose pose several images share"
        ),
    )
    refuse_row(
        ~rolls & shutter.twist.any(axis=1),
        lambda image: (
            f"rolling_shutter: image {problem.image_ids[image]}: expected a zero twist, because "
            "its camera has a global shutter"
        ),
    )


def selected(
    shutter: RollingShutter, images: NDArray[np.int64], cameras: NDArray[np.int64]
) -> RollingShutter:
    """Return the rolling shutters of selected images and cameras.

    A neighbour that is left out is replaced by the image itself. An image without any neighbour
    then has none.
    """
    neighbours = shutter.neighbours
    if neighbours is not None:
        before = neighbours
        place = np.full(len(before) + 1, -1, np.int32)
        place[images] = np.arange(len(images), dtype=np.int32)
        pairs = place[before[images]]
        own = np.arange(len(images), dtype=np.int32)[:, None]
        pairs = np.where(pairs < 0, own, pairs)
        pairs[pairs[:, 0] == pairs[:, 1]] = -1
        neighbours = freeze(pairs)
    frames = None if shutter.frames is None else freeze(shutter.frames[images])
    return shutter.replace(
        direction=tuple(shutter.direction[camera] for camera in cameras.tolist()),
        readout=freeze(shutter.readout[cameras]),
        twist=freeze(shutter.twist[images]),
        frames=frames,
        neighbours=neighbours,
    )


def refuse(problem: ProblemArrays, shutter: RollingShutter | None, what: str) -> None:
    """Raise an InputError if an image has a rolling shutter.

    Args:
        what: argument or command that does not support rolling shutters.
    """
    if shutter is None or not shutter.is_rolling.any():
        return
    camera = problem.camera_ids[int(np.argmax(shutter.is_rolling))]
    raise InputError(
        f"{what}: expected cameras with global shutters, found a rolling shutter (camera {camera})"
    )
