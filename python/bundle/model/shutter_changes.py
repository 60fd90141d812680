"""Rolling shutters of problems whose cameras or length unit change; None stays None."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.errors import InputError
from bundle.model.problem import Problem
from bundle.model.rolling_shutter import RollingShutter


def scaled(shutter: RollingShutter | None, scale: ArrayLike) -> RollingShutter | None:
    """Return the rolling shutters after a change of the length unit.

    A twist is in the frame of its camera: rotations and translations of the world do not change it.

    Args:
        shutter: rolling shutters before.
        scale: new per old lengths, one number or (num_images,).
    """
    if shutter is None:
        return None
    twist = shutter.twist.copy()
    twist[:, 3:] *= np.asarray(scale, float).reshape(-1, 1)
    return shutter.replace(twist=twist)


def shutter_of_cameras(
    shutter: RollingShutter | None, rows: NDArray[np.int64]
) -> RollingShutter | None:
    """Return the rolling shutters for other cameras: copies of the cameras ``rows``, by index."""
    if shutter is None:
        return None
    return shutter.replace(
        direction=tuple(shutter.direction[row] for row in rows.tolist()),
        readout=shutter.readout[rows],
    )


def can_roll(problem: Problem) -> bool:
    """Return True if rolling shutters can be added: known sizes, no rigs, no shutters so far."""
    sizes = problem.camera_sizes[problem.image_camera]
    shutter = problem.rolling_shutter
    is_global = shutter is None or not shutter.is_rolling.any()
    return bool(is_global and not problem.num_frames and sizes.size and (sizes > 0).all())


def check_same_shutter(problem: Problem, cameras: NDArray[np.int64]) -> None:
    """Check that cameras have the same direction and readout.

    Raises:
        InputError: two cameras differ.
    """
    shutter = problem.rolling_shutter
    if shutter is None:
        return
    words = [
        f"{direction}, readout {readout:g}"
        for direction, readout in zip(shutter.direction, shutter.readout.tolist(), strict=True)
    ]
    first = int(cameras[0])
    for camera in cameras[1:].tolist():
        if words[camera] != words[first]:
            raise InputError(
                f"camera {problem.camera_ids[camera]}: expected the shutter of camera "
                f"{problem.camera_ids[first]} ({words[first]}) to share it, found {words[camera]}"
            )
