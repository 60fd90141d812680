"""Lenses of other programs that no camera model equals: a model fitted to their rays.

The fit minimises the distance in pixels over a polar grid of rays
(``bundle.model.lenses.lens_fit``). Its reported error is the largest distance on that grid. A lens
that is symmetric about its axis has the image radius rho(theta) at the angle theta to the axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.model.cameras import project
from bundle.model.lenses.lens_fit import fit_lens

NUM_RADII = 48
NUM_DIRECTIONS = 8


class FittedLens(NamedTuple):
    """Parameters of the fitted model, and the largest distance to the given lens in pixels."""

    params: NDArray[np.float64]
    error: float


def fitted_lens(
    model: str,
    focal: float,
    center: NDArray[np.float64],
    angles: NDArray[np.float64],
    radii: NDArray[np.float64],
) -> FittedLens | None:
    """Fit a symmetric lens; return None if the model cannot project all its rays.

    Args:
        focal: focal length in pixels for the start.
        angles: (n,) angles to the axis in radians, ascending.
        radii: (n,) radii in pixels at these angles.
    """
    turns = np.arange(NUM_DIRECTIONS) * (2 * np.pi / NUM_DIRECTIONS)
    directions = np.column_stack([np.cos(turns), np.sin(turns)])
    rays = np.concatenate(
        [
            np.column_stack([np.sin(angles)[:, None] * direction, np.cos(angles)])
            for direction in directions
        ]
    )
    xy = np.concatenate([center + radii[:, None] * direction for direction in directions])
    start = "SIMPLE_FISHEYE" if "FISHEYE" in model else "SIMPLE_PINHOLE"
    return fitted_to_rays(model, (start, np.array([focal, *center])), rays, xy)


def fitted_to_rays(
    model: str,
    start: tuple[str, NDArray[np.float64]],
    rays: NDArray[np.float64],
    xy: NDArray[np.float64],
) -> FittedLens | None:
    """Fit any lens; return None if the model cannot project all its rays.

    ``rays``: (n, 3) directions. ``xy``: (n, 2) pixels of these rays.
    """
    fit = fit_lens(model, start, rays, xy)
    if fit is None:
        return None
    fitted, _ = project(model, fit.params, rays)
    return FittedLens(fit.params, float(np.linalg.norm(fitted - xy, axis=1).max()))
