"""Residuals of single images, for drawing on their photographs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.problem import Problem
from bundle.model.residuals import Residuals
from bundle.model.worst_images import ImageError, worst_of_errors

MOST_IMAGES = 6
MOST_ARROWS = 400


@dataclass(frozen=True, eq=False, kw_only=True)
class ImageResiduals:
    """Residuals of one image.

    Attributes:
        error: RMSE, largest residual, name and id.
        camera_id: id of its camera.
        size: (2,) width and height [pixels]; 0 if unknown.
        xy: (n, 2) measured positions [pixels] of the largest residuals, at most 400.
        residual: (n, 2) residuals at these positions [pixels].
    """

    error: ImageError
    camera_id: int
    size: tuple[int, int]
    xy: NDArray[np.float64]
    residual: NDArray[np.float64]


def worst_residuals(
    problem: Problem, found: Residuals, most: int = MOST_IMAGES
) -> list[ImageResiduals]:
    """Return the residuals of the images with the largest RMSE, the largest first."""
    lengths = np.where(found.counted, found.lengths, np.nan)
    behind = np.zeros(len(lengths), bool)  # observations that do not count have length NaN
    return image_residuals(
        problem, found, worst_of_errors(problem, lengths, behind, "algebraic", most=most)
    )


def image_residuals(
    problem: Problem, found: Residuals, images: Iterable[ImageError]
) -> list[ImageResiduals]:
    """Return the residuals of some images."""
    index = {int(image_id): place for place, image_id in enumerate(problem.image_ids)}
    counted = np.flatnonzero(found.counted)
    counted = counted[np.argsort(problem.observation_image[counted], kind="stable")]
    ends = np.searchsorted(problem.observation_image[counted], np.arange(problem.num_images + 1))
    result = []
    for error in images:
        image = index[error.image_id]
        camera = problem.image_camera[image]
        rows = counted[ends[image] : ends[image + 1]]
        rows = rows[np.argsort(-found.lengths[rows], kind="stable")[:MOST_ARROWS]]
        width, height = problem.camera_sizes[camera].tolist()
        result.append(
            ImageResiduals(
                error=error,
                camera_id=int(problem.camera_ids[camera]),
                size=(width, height),
                xy=problem.observation_xy[rows],
                residual=found.xy[rows],
            )
        )
    return result
