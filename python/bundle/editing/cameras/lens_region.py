"""Image region of a lens fit: pixels to fit, and pixels at which to judge the fit.

The fit is judged at the pixels of the observations. It uses a grid of pixels, so that crowded parts
of the image do not dominate. The grid covers the image up to the distance of the farthest
observation from the principal point, because nothing has determined the old lens farther out. If
there are few observations it is the whole image; for a perspective lens, up to 80 degrees from the
axis.

The image is given by its size, and observations outside it are gross errors and do not count. If
there is no size, or most observations are outside because the origin is elsewhere, the bounding box
of the observations is used; with few observations, it is extended to half a focal length on each
side of the principal point.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import plural
from bundle.editing.cameras.exact_image import PERSPECTIVE, focal_and_center
from bundle.editing.cameras.pixel_rays import angles, pixel_rays
from bundle.errors import InputError

__all__ = ["LensRegion", "lens_region"]

GRID = 24
"""Pixels along each side of the grid."""

FEWEST_OBSERVATIONS = 30

WIDEST = np.radians(80)

_SEES_BEHIND = ("SIMPLE_DIVISION", "DIVISION")


class LensRegion(NamedTuple):
    """Pixels (N, 2), and unit vectors (N, 3) of the old lens at these pixels.

    There is one set for the grid and one for the observations, without those that have no ray.
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

    Args:
        what: name of the camera for messages.
        old_model: model of the old lens.
        old: its parameters.
        model: of the new lens.
        size: width and height of the image, 0 if unknown.
        observed: (N, 2) pixels of the observations.

    Raises:
        InputError: the new model cannot project observed rays, or the old lens has no rays.
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
        raise InputError(
            f"{what}: expected a lens with rays, found 0 rays at the pixels of its image"
        )
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
