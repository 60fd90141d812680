"""Tables of a problem as columns: cameras, images, points and observations with residuals.

Columns are NumPy arrays by name; a problem is a :class:`bundle.Problem`. ``frame_of`` of
``bundle.interface.tabular`` makes a pandas.DataFrame of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.interface.option_fields import choice
from bundle.model.cameras import camera_models

Columns = dict[str, Any]
_POSE = ("qx", "qy", "qz", "qw", "tx", "ty", "tz")


def table(problem: Any, name: str) -> Columns:
    """Return the columns of a table; see :data:`TABLES`.

    Raises:
        InputError: the table is unknown.
    """
    return TABLES[choice("table", name, tuple(TABLES))](problem)


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
