"""Movement of camera positions and lenses from the input to the output of a solve.

Positions are compared in the frame of the output: if the input was moved to its priors by a
similarity, the similarity moves its positions, too. The size of the scene is twice the median
distance of the points from their median, or of the camera positions from theirs if that is larger.
A few far points do not change it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.cameras import param_kinds
from bundle.model.problem import Problem
from bundle.model.reprojection import quantiles
from bundle.model.rotations import rotation_matrices

if TYPE_CHECKING:
    from bundle.georeference.similarity import Similarity

MOST_POINTS = 100_000
"""Number of points, taken at equal steps, from which the size of a scene is computed."""


@dataclass(frozen=True, kw_only=True)
class Movement:
    """Changes of images and lenses. All medians are nan if nothing changed.

    Attributes:
        num_images: number of images whose pose changed.
        position: median distance by which the positions of these images moved, in length units of
            the output.
        largest_position: the largest distance.
        rotation: median angle by which these images turned, in degrees.
        scene_size: size of the scene in the same length unit.
        num_cameras: number of cameras whose parameters changed.
        focal: median relative change of the focal length |f / f0 - 1| over the images of these
            cameras; 0 if their focal lengths did not change.
    """

    num_images: int
    position: float
    largest_position: float
    rotation: float
    scene_size: float
    num_cameras: int
    focal: float


def movement(before: Problem, after: Problem, similarity: Similarity | None = None) -> Movement:
    """Return the changes between two problems with the same images in the same order.

    Args:
        before: the input; its cameras may be other ones.
        after: the output.
        similarity: motion of the input to its priors, or None.
    """
    centers, turns = before.projection_centers, rotation_matrices(before.cam_from_world[:, :4])
    moved = (before.cam_from_world != after.cam_from_world).any(axis=1)
    if similarity is not None:
        centers, turns = similarity.apply(centers), turns @ similarity.rotation.T
        moved[:] = True
    distances = np.linalg.norm(after.projection_centers[moved] - centers[moved], axis=1)
    # The Frobenius norm of the difference of two rotations is sqrt(8) sin(angle / 2).
    turned = rotation_matrices(after.cam_from_world[moved, :4]) - turns[moved]
    half = np.clip(np.linalg.norm(turned, axis=(1, 2)) / np.sqrt(8), 0, 1)
    num_cameras, focal = _lenses(before, after)
    return Movement(
        num_images=int(moved.sum()),
        largest_position=float(distances.max()) if len(distances) else float("nan"),
        position=_median(distances),
        rotation=_median(np.degrees(2 * np.arcsin(half))),
        scene_size=max(_size(after.points), _size(after.projection_centers)),
        num_cameras=num_cameras,
        focal=focal,
    )


def _lenses(before: Problem, after: Problem) -> tuple[int, float]:
    """Return the number of changed cameras, and the median change of their focal lengths."""
    first, last = before.image_camera, after.image_camera
    width = max(before.camera_params.shape[1], after.camera_params.shape[1])
    params = [_widened(one.camera_params, width) for one in (before, after)]
    models = [np.array(one.camera_models) for one in (before, after)]
    changed = (params[0][first] != params[1][last]).any(axis=1)
    changed |= models[0][first] != models[1][last]
    ratios = np.abs(_focals(after)[last] / _focals(before)[first] - 1)[changed]
    cameras = np.count_nonzero(np.bincount(last[changed]))
    return int(cameras), _median(ratios[np.isfinite(ratios)])


def _widened(params: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    return np.pad(params, ((0, 0), (0, width - params.shape[1])))


def _focals(problem: Problem) -> NDArray[np.float64]:
    """Return the mean focal length of each camera; nan for a model without any."""
    focals = np.full(problem.num_cameras, np.nan)
    models = np.array(problem.camera_models)
    for model in set(problem.camera_models):
        columns = [k for k, kind in enumerate(param_kinds(model)) if kind == "focal"]
        if columns:
            of_model = models == model
            focals[of_model] = np.abs(problem.camera_params[of_model][:, columns]).mean(axis=1)
    return focals


def _size(points: NDArray[np.float64]) -> float:
    if not len(points):
        return 0.0
    some = points[:: -(-len(points) // MOST_POINTS)]
    center = np.array([_median(coordinate.copy()) for coordinate in some.T])
    return 2 * _median(np.linalg.norm(some - center, axis=1))


def _median(values: NDArray[np.float64]) -> float:
    """Return the median; nan without values, which are reordered."""
    return quantiles(values, [0.5])[0] if len(values) else float("nan")
