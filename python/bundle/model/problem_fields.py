"""Arrays of a problem: their declarations and defaults, and the checks that are not in the core.

The core checks shapes, numbers and indices of all arrays in one pass (``_core.validate``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import Array, Index, declare, default_of, filled, immutable, refuse_row
from bundle.errors import InputError
from bundle.model import rig_arrays
from bundle.model.problem_arrays import ProblemArrays

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
