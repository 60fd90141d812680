"""Lenses that two camera models can both represent, and rays of pixels.

Most models are a special case of larger models. This module describes a lens independently of its
model. The description has the mapping of rays to coordinates (``perspective``, u = X / Z, or
``equidistant``, u = theta X / r), two focal lengths, a principal point, and the coefficients that
have an effect:

- ``r1`` ... ``r6``: radial polynomial 1 + r1 s + r2 s^2 + ... with s = u^2 + v^2,
- ``d1`` ... ``d3``: denominator of FULL_OPENCV,
- ``p1, p2, sx, sy``: tangential and thin prism terms of (u, v),
- ``P1, P2, Sx, Sx2, Sy, Sy2``: the same terms of RAD_TAN_THIN_PRISM_FISHEYE, which are functions of
  the coordinates after the radial polynomial; without a polynomial they equal the terms above,
- ``division``, ``omega``, ``alpha`` and ``beta``: coefficients of models that no other model
  contains.

A model can represent this lens if it has the same mapping of rays and all its coefficients. EUCM
with alpha = 0 and the division models with k = 0 are perspective. FOV with omega = 0 is perspective
as well, but its derivatives w.r.t. omega are zero there, which would stall other solvers. Therefore
perspective lenses are converted to FOV by a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.optional_packages import has_pycolmap
from bundle.model.cameras import param_kinds, project

_EXTRAS: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": (),
    "PINHOLE": (),
    "SIMPLE_RADIAL": ("r1",),
    "RADIAL": ("r1", "r2"),
    "OPENCV": ("r1", "r2", "p1", "p2"),
    "FULL_OPENCV": ("r1", "r2", "p1", "p2", "r3", "d1", "d2", "d3"),
    "FOV": ("omega",),
    "SIMPLE_DIVISION": ("division",),
    "DIVISION": ("division",),
    "EUCM": ("alpha", "beta"),
    "SIMPLE_FISHEYE": (),
    "FISHEYE": (),
    "SIMPLE_RADIAL_FISHEYE": ("r1",),
    "RADIAL_FISHEYE": ("r1", "r2"),
    "OPENCV_FISHEYE": ("r1", "r2", "r3", "r4"),
    "THIN_PRISM_FISHEYE": ("r1", "r2", "p1", "p2", "r3", "r4", "sx", "sy"),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        *("r1", "r2", "r3", "r4", "r5", "r6"),
        *("P2", "P1", "Sx", "Sx2", "Sy", "Sy2"),
    ),
}
"""Coefficients of each model in the order of its parameters after the principal point."""

_WITHOUT_RADIAL = {"p1": "P1", "p2": "P2", "sx": "Sx", "sy": "Sy"}

PERSPECTIVE = frozenset(model for model in _EXTRAS if "FISHEYE" not in model)
"""Models with u = X / Z near the axis; the other models have u = theta X / r."""


class _Lens(NamedTuple):
    rays: str
    focal: tuple[float, float]
    center: tuple[float, float]
    coefficients: dict[str, float]


def extras_of(model: str, params: NDArray[np.float64] | None = None) -> dict[str, float]:
    """Return the coefficients of a model in the order of its parameters; 0 without coefficients."""
    names = _EXTRAS[model]
    values = [0.0] * len(names) if params is None else params[len(params) - len(names) :].tolist()
    return dict(zip(names, values, strict=True))


def is_symmetric(model: str, params: NDArray[np.float64]) -> bool:
    """Return True if a lens is symmetric about its axis."""
    return not params[asymmetric_params(model)[2:]].any()


def asymmetric_params(model: str) -> list[int]:
    """Return the indices of the principal point and of asymmetric coefficients."""
    num_focal = param_kinds(model).count("focal")
    extras = enumerate(_EXTRAS[model], start=num_focal + 2)
    return [num_focal, num_focal + 1, *(index for index, name in extras if name[0] in "pPsS")]


def focal_and_center(model: str, params: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return fx, fy, cx, cy of a model that has them."""
    num_focal = param_kinds(model).count("focal")
    fx, fy = params[0], params[num_focal - 1]
    return float(fx), float(fy), float(params[num_focal]), float(params[num_focal + 1])


def exact_params(
    model: str, params: NDArray[np.float64], target: str
) -> NDArray[np.float64] | None:
    """Return the parameters with which a model equals another lens; None if it cannot."""
    if model == target:
        return params
    lens = _lens(model, params)
    names = _EXTRAS[target]
    coefficients = dict(lens.coefficients)
    if not any(name[0] == "r" for name in coefficients):
        there = _WITHOUT_RADIAL
        if "p1" in names:
            there = {after: before for before, after in there.items()}
        coefficients = {there.get(name, name): value for name, value in coefficients.items()}
    num_focal = param_kinds(target).count("focal")
    if (
        lens.rays != _rays(target)
        or not coefficients.keys() <= set(names)
        or (num_focal == 1 and lens.focal[0] != lens.focal[1])
        or target == "FOV"
    ):
        return None
    neutral = {"beta": 1.0}
    extras = [coefficients.get(name, neutral.get(name, 0.0)) for name in names]
    return np.array([*lens.focal[:num_focal], *lens.center, *extras])


def _rays(model: str) -> str:
    return "perspective" if model in PERSPECTIVE else "equidistant"


def _lens(model: str, params: NDArray[np.float64]) -> _Lens:
    fx, fy, cx, cy = focal_and_center(model, params)
    coefficients = {name: value for name, value in extras_of(model, params).items() if value}
    if "alpha" not in coefficients:
        coefficients.pop("beta", None)
    return _Lens(_rays(model), (fx, fy), (cx, cy), coefficients)


# Inverse projection: rays of a camera at given pixels, to machine precision.
#
# Only the simplest models have a closed form. A ray at the angle theta to the axis is found by
# Newton's method in the chart
#
#     w = theta (cos phi, sin phi),   d(w) = (S w_1, S w_2, cos theta),   S = sin(theta) / theta,
#
# which is regular on the axis and beyond 90 degrees. With e = (cos theta - S) / theta^2
#
#     dd/dw_j = (S e_j + e w_j w, -S w_j),
#
# where e_j is the j-th unit vector, and the chain rule gives the 2x2 Jacobian of the pixels. A step
# is halved until it reduces the distance to the pixel and ends where the lens is not folded. Beyond
# the fold, the determinant of the Jacobian is not positive and images are mirrored. A pixel that
# only has such rays counts as a pixel without a ray. The iteration starts at the angle of the
# undistorted lens, or nearer to the axis if this angle is beyond the fold.


MAX_ITERATIONS = 60
MAX_HALVINGS = 12
MAX_STEP = 0.3  # largest step in radians

PRECISION = 1e-9  # largest distance of a ray's projection from its pixel, in focal lengths


def pixel_rays(
    model: str, params: NDArray[np.float64], xy: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the unit vectors of a camera at pixels.

    ``xy``: (N, 2) pixels.

    Returns:
        Rays (N, 3), and the mask (N,) of pixels that have a ray; other rays are undefined.
    """
    fx, fy, cx, cy = focal_and_center(model, params)
    chart = (xy - (cx, cy)) / (fx, fy)
    radius = np.hypot(chart[:, 0], chart[:, 1])
    start = np.arctan(radius) if model in PERSPECTIVE else np.minimum(radius, np.pi / 2)
    chart *= (start / np.where(radius > 0, radius, 1))[:, None]
    focal = min(fx, fy)
    error, jacobian = _distance(model, params, xy, chart)
    for _ in range(MAX_HALVINGS):
        beyond = ~_unfolded(error, jacobian)
        if not beyond.any():
            break
        chart[beyond] /= 2
        error[beyond], jacobian[beyond] = _distance(model, params, xy[beyond], chart[beyond])
    for _ in range(MAX_ITERATIONS):
        active = np.flatnonzero(np.linalg.norm(error, axis=1) > 1e-4 * PRECISION * focal)
        if not len(active):
            break
        if not _newton_step(model, params, xy, chart, error, jacobian, active):
            break
    close = np.linalg.norm(error, axis=1) <= PRECISION * focal
    return _directions(chart), close & _unfolded(error, jacobian)


def angles(rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angle of each ray to the optical axis, in radians."""
    return np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])


def _newton_step(
    model: str,
    params: NDArray[np.float64],
    xy: NDArray[np.float64],
    chart: NDArray[np.float64],
    error: NDArray[np.float64],
    jacobian: NDArray[np.float64],
    active: NDArray[np.int64],
) -> bool:
    """Move the rays of `active` pixels in place; return True if some errors became smaller."""
    active = active[_unfolded(error[active], jacobian[active])]
    step = -np.linalg.solve(jacobian[active], error[active][:, :, None])[:, :, 0]
    length = np.linalg.norm(step, axis=1)
    step *= (MAX_STEP / np.maximum(length, MAX_STEP))[:, None]
    before = np.linalg.norm(error[active], axis=1)
    improved = False
    for _ in range(MAX_HALVINGS):
        if not len(active):
            break
        tried = chart[active] + step
        new_error, new_jacobian = _distance(model, params, xy[active], tried)
        better = np.linalg.norm(new_error, axis=1) < before
        better &= _unfolded(new_error, new_jacobian)
        rows = active[better]
        chart[rows], error[rows], jacobian[rows] = (
            tried[better],
            new_error[better],
            new_jacobian[better],
        )
        improved = improved or bool(better.any())
        active, step, before = active[~better], step[~better] / 2, before[~better]
    return improved


def _unfolded(error: NDArray[np.float64], jacobian: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask of rays that project and are not mirrored."""
    unfolded: NDArray[np.bool_] = np.isfinite(error).all(axis=1) & (np.linalg.det(jacobian) > 0)
    return unfolded


def _distance(
    model: str,
    params: NDArray[np.float64],
    xy: NDArray[np.float64],
    chart: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return projection minus pixel, nan without a projection, and the 2x2 Jacobian."""
    rays, by_chart = _directions(chart), _chart_jacobian(chart)
    projected = project(model, params, rays, jacobians=True)
    error = projected.xy - xy
    if model in PERSPECTIVE:
        error[~projected.valid] = np.nan
    jacobian = projected.d_point @ by_chart
    return error, np.where(np.isfinite(jacobian), jacobian, 0.0)


def _directions(chart: NDArray[np.float64]) -> NDArray[np.float64]:
    angle = np.hypot(chart[:, 0], chart[:, 1])
    return np.column_stack([chart * np.sinc(angle / np.pi)[:, None], np.cos(angle)])


def _chart_jacobian(chart: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the derivatives of the rays with respect to the chart, (N, 3, 2)."""
    square = (chart**2).sum(axis=1)
    angle = np.sqrt(square)
    ratio = np.sinc(angle / np.pi)
    near = square < 1e-4
    bend = np.where(
        near,
        -1 / 3 + square / 30 - square**2 / 840,
        (np.cos(angle) - ratio) / np.where(near, 1, square),
    )
    jacobian = np.empty((len(chart), 3, 2))
    jacobian[:, :2] = bend[:, None, None] * chart[:, :, None] * chart[:, None, :]
    jacobian[:, [0, 1], [0, 1]] += ratio[:, None]
    jacobian[:, 2] = -ratio[:, None] * chart
    return jacobian


# From pixels to the plane z = 1 of the camera, by COLMAP's inverse of its models (Newton's method,
# src/colmap/sensor/models.h, CamFromImg). Without pycolmap, the inverse above serves, which has
# machine precision but is slower.


def normalized(model: str, params: Sequence[float], xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return undistorted coordinates (N, 2) on the plane z = 1 of the camera.

    Args:
        params: parameters of the model in COLMAP's order, without padding.
        xy: (N, 2) pixels.
    """
    if not has_pycolmap():
        directions, seen = pixel_rays(model, np.array(params, np.float64), xy)
        plane: NDArray[np.float64] = directions[:, :2] / directions[:, 2:]
        return np.where(seen[:, None], plane, np.nan)
    import pycolmap

    # The size of the image has no effect.
    lens = pycolmap.Camera(model=model, width=1, height=1, params=list(params))
    rays: NDArray[np.float64] = np.asarray(lens.cam_from_img(xy), np.float64)
    return rays


def pixel_directions(
    model: str, params: Sequence[float], xy: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the directions (N, 3) of pixels in the frame of the camera, with z = 1.

    Args: see :func:`normalized`.
    """
    return np.column_stack([normalized(model, params, xy), np.ones(len(xy))])
