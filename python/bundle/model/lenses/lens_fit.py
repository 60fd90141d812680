"""Least-squares fit of a camera model to pixels of given rays, and the image region of the fit.

The fit computes

    min over p  sum_i |project(p, ray_i) - xy_i|^2,

The minimiser is Levenberg-Marquardt with columns scaled by their norms (Marquardt 1963; Moré 1978).
Each step is the least-squares solution of

    [J; sqrt(lambda) D] step = [-r; 0],

by orthogonal factorisation, because polynomials of high degree are too ill-conditioned for the
normal equations. A step needs only the triangle R of the QR factorisation of [J r]. The best fit to
a lens that is symmetric about its axis is a symmetric lens; the principal point and the asymmetric
coefficients then stay constant. Some models are strongly nonlinear, or have zero derivatives, at
their neutral parameters. Therefore a fit starts from several lenses, and the best result is used.

The error of the fit is evaluated at the pixels of the observations. The fit itself uses a grid of
pixels, so that regions with many observations do not dominate. The grid covers the image up to the
distance of the farthest observation from the principal point, because no observation has determined
the old lens farther out. With few observations, the grid covers the entire image; for a perspective
lens, up to 80 degrees from the axis.

The size of the image defines its borders. Observations outside the image are gross errors and are
ignored. The bounding box of the observations is used instead if the size is unknown, or if most
observations are outside because of another origin. With few observations, this box is extended to
half a focal length on each side of the principal point.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import plural
from bundle.errors import InputError
from bundle.model.cameras import param_kinds, project
from bundle.model.lenses.exact_image import (
    PERSPECTIVE,
    angles,
    asymmetric_params,
    extras_of,
    focal_and_center,
    is_symmetric,
    pixel_rays,
)

GRID = 24  # pixels along each side of the grid

FEWEST_OBSERVATIONS = 30

WIDEST = np.radians(80)

_SEES_BEHIND = ("SIMPLE_DIVISION", "DIVISION")


class LensRegion(NamedTuple):
    """Pixels (N, 2), and unit vectors (N, 3) of the old lens at these pixels.

    There is one set for the grid and one for the observations. Pixels without a ray are left out.
    """

    grid: NDArray[np.float64]
    grid_rays: NDArray[np.float64]
    observed: NDArray[np.float64]
    observed_rays: NDArray[np.float64]
    num_without_ray: int


def lens_region(
    what: str,
    old_model: str,
    old: NDArray[np.float64],
    model: str,
    size: NDArray[np.int64],
    observed: NDArray[np.float64],
) -> LensRegion:
    """Return the pixels at which a lens of another model must agree with the old one.

    ``size``: width and height of the image, 0 if unknown. ``observed``: (N, 2) pixels of the
    observations.
    """
    rays, seen = pixel_rays(old_model, old, observed)
    num_without_ray = int((~seen).sum())
    rays, observed = rays[seen], observed[seen]
    _check_field_of_view(what, old_model, model, rays)
    enough = len(observed) >= FEWEST_OBSERVATIONS
    grid = _grid(old_model, old, size, observed, enough=enough)
    grid_rays, seen = pixel_rays(old_model, old, grid)
    if model in PERSPECTIVE:
        widest = angles(rays).max() if enough else WIDEST
        seen &= angles(grid_rays) <= widest
    if not seen.any():
        raise InputError(f"{what}: expected pixels with rays in the image, found 0")
    return LensRegion(grid[seen], grid_rays[seen], observed, rays, num_without_ray)


def _check_field_of_view(what: str, old_model: str, model: str, rays: NDArray[np.float64]) -> None:
    """Refuse rays of the old lens that no lens of the new model can project."""
    both_bend = model not in PERSPECTIVE and old_model not in PERSPECTIVE
    if model in _SEES_BEHIND or both_bend:
        return
    behind = rays[:, 2] <= 0
    if behind.any():
        raise InputError(
            f"{what}: expected observations less than 90 degrees from the axis, the limit "
            f"of {model}, found {plural(int(behind.sum()), 'observation')} at up to "
            f"{np.degrees(angles(rays).max()):.1f} degrees"
        )


def _grid(
    model: str,
    params: NDArray[np.float64],
    size: NDArray[np.int64],
    observed: NDArray[np.float64],
    *,
    enough: bool,
) -> NDArray[np.float64]:
    """Return pixels on a grid."""
    fx, fy, cx, cy = focal_and_center(model, params)
    center = np.array([cx, cy])
    box = observed
    inside = ((observed >= 0) & (observed <= size)).all(axis=1)
    if (size > 0).all() and 2 * inside.sum() >= len(observed):
        box, observed = np.array([[0.0, 0.0], size]), observed[inside]
    elif not enough:
        half = np.array([fx, fy]) / 2
        box = np.vstack([observed, center - half, center + half])
    low, high = box.min(axis=0), box.max(axis=0)
    radius = np.inf
    if enough:
        radius = float(np.linalg.norm(observed - center, axis=1).max())
        low, high = np.maximum(low, center - radius), np.minimum(high, center + radius)
    sides = [np.linspace(low[axis], high[axis], GRID) for axis in range(2)]
    grid = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    within: NDArray[np.float64] = grid[np.linalg.norm(grid - center, axis=1) <= radius]
    return within


MAX_ITERATIONS = 200

TOLERANCE = 1e-6  # relative decrease of the cost below which the fit has converged

SMALLEST = 1e-6  # negligible error in pixels

_STARTS: dict[str, tuple[tuple[float, ...], ...]] = {
    "omega": ((0.1,), (0.5,), (0.9,), (1.5,)),
    "division": ((0.0,), (-0.2,)),
    "alpha": ((0.2, 1.0), (0.5, 1.0), (0.7, 1.5)),
}
"""Start values of a model's coefficients, by the name of its first coefficient."""

_BOUNDS = {"omega": (0.0101, 3.1), "alpha": (0.0, 1.0), "beta": (1e-3, np.inf)}
"""Bounds of parameters. COLMAP's formula of FOV is discontinuous at omega 0.01, and its signs
differ below this value (see ``fov.h``).
"""


class LensFit(NamedTuple):
    """Parameters, and True if they are a minimum to the precision of the numbers."""

    params: NDArray[np.float64]
    converged: bool


def fit_lens(
    model: str,
    lens: tuple[str, NDArray[np.float64]],
    rays: NDArray[np.float64],
    xy: NDArray[np.float64],
) -> LensFit | None:
    """Fit a lens to pixels of rays.

    ``rays``: (N, 3) directions within the field of view of the model. ``xy``: (N, 2) pixels of
    these rays.

    Returns:
        The fit; None if no start lens projects all rays.
    """
    free = np.arange(len(param_kinds(model)))
    if is_symmetric(*lens):
        free = np.setdiff1d(free, asymmetric_params(model))
    best: tuple[float, LensFit] | None = None
    for start in _starts(model, *lens):
        cost, fit = _minimize(model, start, rays, xy, free)
        if np.isfinite(cost) and (best is None or cost < best[0]):
            best = cost, fit
    return None if best is None else best[1]


def _starts(
    model: str, old_model: str, old_params: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Return lenses of a model with the focal length and the principal point of another lens."""
    fx, fy, cx, cy = focal_and_center(old_model, old_params)
    num_focal = param_kinds(model).count("focal")
    focal = (fx, fy) if num_focal == 2 else (np.sqrt(fx * fy),)
    names = tuple(extras_of(model))
    choices = _STARTS.get(names[0], ()) if names else ()
    if not choices:
        old = extras_of(old_model, old_params)
        shared = tuple(old.get(name, 0.0) for name in names)
        choices = tuple(dict.fromkeys([shared, (0.0,) * len(names)]))
    starts = []
    for extras in choices:
        scale = 1.0
        if names[:1] == ("omega",):  # FOV: use the focal length on the axis
            scale = extras[0] / (2 * np.tan(extras[0] / 2))
        starts.append(np.array([*(scale * f for f in focal), cx, cy, *extras]))
    return starts


def _minimize(
    model: str,
    params: NDArray[np.float64],
    rays: NDArray[np.float64],
    xy: NDArray[np.float64],
    free: NDArray[np.int64],
) -> tuple[float, LensFit]:
    """Return the final cost and the fit; the cost is infinite if a ray does not project."""
    lower, upper = _bounds(model)
    cost, triangle = _linearized(model, params, rays, xy, free)
    smallest = len(xy) * SMALLEST**2
    damping, converged = 1e-3, cost <= smallest
    for _ in range(MAX_ITERATIONS):
        if converged or not np.isfinite(cost):
            break
        step = _step(triangle, damping, lower[free] - params[free], upper[free] - params[free])
        candidate = params.copy()
        candidate[free] = np.clip(params[free] + step, lower[free], upper[free])
        new_cost, new_triangle = _linearized(model, candidate, rays, xy, free)
        if new_cost < cost:
            converged = cost - new_cost <= TOLERANCE * cost or new_cost <= smallest
            params, cost, triangle = candidate, new_cost, new_triangle
            damping = max(damping / 10, 1e-15)
        else:
            moved = np.abs(candidate[free] - params[free]) * np.linalg.norm(triangle, axis=0)[:-1]
            converged = bool(moved.max() <= SMALLEST * np.sqrt(len(xy)))
            damping *= 10
    return cost, LensFit(params, bool(converged))


def _step(
    triangle: NDArray[np.float64],
    damping: float,
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return a step; parameters that would leave their bounds stay constant."""
    scale = np.linalg.norm(triangle[:, :-1], axis=0)
    scale[scale == 0] = 1.0
    rows = np.vstack([triangle[:, :-1], np.diag(np.sqrt(damping) * scale)])
    target = np.concatenate([triangle[:, -1], np.zeros(len(scale))])
    moves = np.ones(len(scale), bool)
    while True:
        step = np.zeros(len(scale))
        step[moves] = np.linalg.lstsq(rows[:, moves], target, rcond=None)[0]
        beyond = ((lower == 0) & (step < 0)) | ((upper == 0) & (step > 0))
        if not beyond.any():
            return step
        moves &= ~beyond


def _bounds(model: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    extras = [_BOUNDS.get(name, (-np.inf, np.inf)) for name in extras_of(model)]
    others = len(param_kinds(model)) - len(extras)
    bounds = np.array([(-np.inf, np.inf)] * others + extras)
    return bounds[:, 0], bounds[:, 1]


def _linearized(
    model: str,
    params: NDArray[np.float64],
    rays: NDArray[np.float64],
    xy: NDArray[np.float64],
    free: NDArray[np.int64],
) -> tuple[float, NDArray[np.float64]]:
    """Return the cost sum |r|^2, infinite without a projection, and the triangle of [J -r]."""
    focal = np.array(param_kinds(model)) == "focal"
    projected = project(model, params, rays, jacobians=True)
    residual = (projected.xy - xy).ravel()
    system = np.column_stack(
        [projected.d_params[:, :, free].reshape(len(residual), len(free)), -residual]
    )
    with np.errstate(over="ignore", invalid="ignore"):
        cost = float(residual @ residual)
    if not (params[focal] > 0).all() or not np.isfinite(cost) or not np.isfinite(system).all():
        return np.inf, system
    triangle: NDArray[np.float64] = np.asarray(np.linalg.qr(system, mode="r"))
    return cost, triangle
