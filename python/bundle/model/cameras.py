"""Camera models: names, parameters, and projection with derivatives."""

from __future__ import annotations

from typing import Literal, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import Array, as_array, as_declared, as_flag
from bundle.errors import InputError
from bundle.interface.option_fields import choice


class CameraParam(NamedTuple):
    """A parameter of a camera model.

    Its kind is "focal", "principal_point", "extra", or "metadata", which no solve refines.
    """

    name: str
    kind: str


class ProjectionResult(NamedTuple):
    """Pixels and their derivatives."""

    xy: NDArray[np.float64]  # (N, 2) pixels; NaN where the projection does not exist
    # (N,) True where the camera sees the point by COLMAP's rules. Most models see points in front
    # of the camera. SIMPLE_DIVISION, DIVISION and EQUIRECTANGULAR see all points whose projection
    # exists
    valid: NDArray[np.bool_]
    # (N, 2, 3) derivative with respect to the point in the camera frame, pixels per length unit
    d_point: NDArray[np.float64]
    # (N, 2, num_params) derivative with respect to the parameters in COLMAP's order
    d_params: NDArray[np.float64]


_MODELS: dict[str, tuple[CameraParam, ...]] = {
    name: tuple(CameraParam(*param) for param in params)
    for name, params, _ in _core.camera_models()
}

_REACH = {name: reach for name, _, reach in _core.camera_models()}


_PARAM_NAMES = {name: tuple(param.name for param in params) for name, params in _MODELS.items()}


def camera_models() -> dict[str, tuple[str, ...]]:
    """Return the parameter names of each camera model, in COLMAP's order, by model name."""
    return dict(_PARAM_NAMES)


def reach(model: str) -> str:
    """Return the range of angles from the optical axis in which a model has no discontinuity.

    "front": less than 90 degrees; also for unknown models. "beyond": more than 90 degrees, up to a
    discontinuity. "all": every direction whose projection exists.
    """
    return _REACH.get(model, "front")


def param_kinds(model: str) -> tuple[str, ...]:
    """Return the kind of each parameter of a model."""
    return tuple(param.kind for param in _params(model))


@overload
def project(
    model: str, params: ArrayLike, points_in_camera: ArrayLike, *, jacobians: Literal[False] = False
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]: ...


@overload
def project(
    model: str, params: ArrayLike, points_in_camera: ArrayLike, *, jacobians: Literal[True]
) -> ProjectionResult: ...


def project(
    model: str, params: ArrayLike, points_in_camera: ArrayLike, *, jacobians: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.bool_]] | ProjectionResult:
    """Project points into the image.

    Args:
        model: COLMAP's name of the model.
        params: parameters in COLMAP's order; focal lengths and principal point in pixels.
        points_in_camera: (N, 3) in the frame of the camera: x right, y down, z forward.
        jacobians: also return the derivatives.

    Returns:
        Pixels (N, 2) and validity (N,), or with ``jacobians=True`` a :class:`ProjectionResult`.
        A point that the camera does not see is not valid, but the formula may still give pixels:
        behind a perspective camera those of the mirrored point, for a fisheye camera those of an
        angle beyond 90 degrees.

    Raises:
        InputError: unknown model, or arrays of the wrong shape.
    """
    expected = _params(model)
    model = choice("camera model", model, _MODELS)
    jacobians = as_flag("jacobians", jacobians)
    param_array = as_array("params", params)
    if param_array.shape != (len(expected),):
        names = ", ".join(param.name for param in expected)
        raise InputError(
            f"{model}: expected {len(expected)} parameters ({names}), "
            f"found an array of shape {param_array.shape}"
        )
    points = as_declared("points_in_camera", points_in_camera, Array(("N", 3)))
    xy, status, d_point, d_params = _core.project(model, param_array, points, jacobians)
    undefined = status == _core.PROJECTION_UNDEFINED
    xy[undefined] = np.nan
    valid = status == _core.PROJECTION_VALID
    if d_point is None or d_params is None:
        return xy, valid
    d_point[undefined] = np.nan
    d_params[undefined] = np.nan
    return ProjectionResult(xy, valid, d_point, d_params)


def _params(model: str) -> tuple[CameraParam, ...]:
    return _MODELS[choice("camera model", model, _MODELS)]
