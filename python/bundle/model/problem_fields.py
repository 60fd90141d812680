"""Types and defaults of a problem's fields, and the checks that are not in the C++ core."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import filled, freeze, immutable
from bundle.errors import InputError
from bundle.model import rig_arrays
from bundle.model.problem_arrays import ProblemArrays

# Fields without a default come first, because the defaults of others depend on their lengths.
DTYPES: dict[str, type] = {
    "cam_from_world": np.float64,
    "camera_params": np.float64,
    "points": np.float64,
    "observation_image": np.int32,
    "observation_point": np.int32,
    "observation_xy": np.float64,
    "observation_keypoint": np.int32,
    "image_ids": np.int64,
    "image_camera": np.int32,
    "camera_ids": np.int64,
    "camera_sizes": np.int64,
    "point_ids": np.int64,
    **rig_arrays.DTYPES,
}

# Fields with a default, and the count that gives their length.
_ONE_FOR_EACH = {
    "image_ids": "num_images",
    "image_camera": "num_images",
    "camera_ids": "num_cameras",
    "camera_sizes": "num_cameras",
    "point_ids": "num_points",
    "observation_keypoint": "num_observations",
}


def default(problem: ProblemArrays, name: str) -> NDArray[Any]:
    """Return the default of an array; the arrays on which it depends must be set."""
    if name in rig_arrays.DTYPES:
        return rig_arrays.default(problem, name)
    if name not in _ONE_FOR_EACH:
        raise InputError(f"{name}: expected numbers, found None")
    count, dtype = getattr(problem, _ONE_FOR_EACH[name]), DTYPES[name]
    if name == "observation_keypoint":
        return filled((count,), -1, dtype)
    if name == "camera_sizes":
        return filled((count, 2), 0, dtype)
    if name == "image_camera" and problem.num_cameras != count:
        if problem.num_cameras != 1:
            raise InputError(
                "image_camera: expected the index of each image's camera, because there are "
                f"{count} images and {problem.num_cameras} cameras, found None"
            )
        return filled((count,), 0, dtype)
    return freeze(np.arange(count, dtype=dtype))


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
    negative = (problem.camera_sizes < 0).any(axis=1)
    if negative.any():
        camera = int(np.argmax(negative))
        width, height = problem.camera_sizes[camera]
        raise InputError(
            f"camera_sizes: camera {problem.camera_ids[camera]}: expected a width and a height of "
            f"at least 0, found {width} x {height}"
        )
    if problem.num_observations and problem.observation_keypoint.min() < -1:
        observation = int(np.argmin(problem.observation_keypoint))
        raise InputError(
            f"observation_keypoint: observation {observation}: expected a keypoint index, or -1 "
            f"without a keypoint, found {problem.observation_keypoint[observation]}"
        )
