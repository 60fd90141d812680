"""Lens statistics: extent of the observations, fold and stretch of radial distortion.

The radial part of SIMPLE_RADIAL, RADIAL and OPENCV maps the undistorted radius r to ``r (1 + k1 r^2
+ k2 r^4)``. It folds at the first zero of its derivative ``1 + 3 k1 s + 5 k2 s^2``, s = r^2: ``s =
2 / (-3 k1 + sqrt(9 k1^2 - 20 k2))`` if that is a positive number. No image point lies beyond the
distorted radius reached there. Folds of other models are not computed.

A lens that does not fold before the farthest observation, at the distorted radius R, stretches its
radius by more than t if R / t is already distorted beyond R: ``k1 s + k2 s^2 > t - 1``, s = (R /
t)^2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.cameras import camera_models, param_kinds
from bundle.model.problem import Problem

# Columns of k1 and of k2, if any, for models with this radial part.
_COEFFICIENTS = {"SIMPLE_RADIAL": (3, None), "RADIAL": (3, 4), "OPENCV": (4, 5)}

STRETCH = 2.0
"""Factor on the radius of the farthest observation, beyond which a distortion is absurd."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Lens:
    """Values per camera.

    Every array is (num_cameras,), NaN if unknown.

    Attributes:
        focal: focal length in pixels, the mean of two.
        size: longer side of the image in pixels; if not recorded, twice the distance of the
            farthest observation from the principal point along an axis.
        farthest: distorted radius of the farthest observation, in focal lengths.
        fold: distorted radius at which the distortion folds, in focal lengths; infinite if never.
        stretched: True if the distortion does not fold before the farthest observation, and more
            than doubles its radius.
    """

    focal: NDArray[np.float64]
    size: NDArray[np.float64]
    farthest: NDArray[np.float64]
    fold: NDArray[np.float64]
    stretched: NDArray[np.bool_]


def lenses(problem: Problem) -> Lens:
    """Return the values of every camera of a problem."""
    focal, fold = np.full((2, problem.num_cameras), np.nan)
    radial = np.zeros((2, problem.num_cameras))
    centre = np.full((problem.num_cameras, 2), np.nan)
    models = np.array(problem.camera_models, dtype=str)
    for model in set(problem.camera_models) & set(camera_models()):
        members = models == model
        params = problem.camera_params[members]
        kinds = np.array(param_kinds(model) + ("",) * (params.shape[1] - len(param_kinds(model))))
        if "focal" in kinds:  # a panorama has no focal length and no principal point
            focal[members] = params[:, kinds == "focal"].mean(1)
            centre[members] = params[:, kinds == "principal_point"]
        fold[members] = np.inf
        if model in _COEFFICIENTS:
            first, second = _COEFFICIENTS[model]
            k2 = np.zeros(len(params)) if second is None else params[:, second]
            fold[members] = fold_radius(params[:, first], k2)
            radial[:, members] = params[:, first], k2

    camera = problem.image_camera[problem.observation_image]
    offset = np.abs(problem.observation_xy - centre[camera])
    reach = _largest(camera, offset.max(axis=1, initial=0.0), problem.num_cameras)
    radius = _largest(camera, np.hypot(offset[:, 0], offset[:, 1]), problem.num_cameras)
    recorded = problem.camera_sizes.max(axis=1, initial=0).astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        square = (radius / focal / STRETCH) ** 2
        gain = (radial[0] + radial[1] * square) * square
        return Lens(
            focal=focal,
            size=np.where(recorded > 0, recorded, 2.0 * reach),
            farthest=radius / focal,
            fold=fold,
            stretched=~(radius / focal > fold) & (gain > STRETCH - 1.0),
        )


def fold_radius(k1: NDArray[np.float64], k2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest distorted radius in focal lengths; infinite without a fold."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        root = np.sqrt(9.0 * k1**2 - 20.0 * k2)
        # Both forms give the same number; the second loses no digits for k1 > 0.
        divisor = np.where(k1 > 0, -20.0 * k2 / (3.0 * k1 + root), root - 3.0 * k1)
        square = np.where(divisor > 0, 2.0 / divisor, np.inf)
        radius = np.sqrt(square) * (1.0 + k1 * square + k2 * square**2)
    return np.where(np.isfinite(square), radius, np.inf)


def _largest(
    group: NDArray[np.int32], values: NDArray[np.float64], size: int
) -> NDArray[np.float64]:
    """Return the largest value of each group, NaN for an empty one."""
    largest = np.full(size, -np.inf)
    known = ~np.isnan(values)
    np.maximum.at(largest, group[known], values[known])
    return np.where(np.isneginf(largest), np.nan, largest)
