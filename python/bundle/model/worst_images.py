"""The images with the largest reprojection errors, by name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.problem import Problem
from bundle.model.reprojection import counted_errors, reprojection_errors, resolve_cheirality

WORST = 5
"""Default number of images to return."""

# Number of observations copied at a time: a copy of hundreds of millions takes gigabytes.
_BLOCK = 1 << 20


@dataclass(frozen=True, kw_only=True)
class ImageError:
    """Reprojection errors of one image, in pixels, over the observations that count.

    Attributes:
        image_id: id of the image in the source.
        name: name of the image; "" if the source has no name for it.
        num_observations: number of observations that count.
        rmse: sqrt(mean ||r||^2).
        max: largest ||r||.
    """

    image_id: int
    name: str
    num_observations: int
    rmse: float
    max: float


def worst_images(
    problem: Problem, cheirality: str = "auto", *, most: int = WORST, num_threads: int = 0
) -> tuple[ImageError, ...]:
    """Return the images with the largest RMSE, the worst first.

    Args:
        problem: the problem; errors are evaluated at its values.
        cheirality: as in a solve; observations that do not count are left out.
        most: largest number of images to return.
        num_threads: number of threads; 0: all cores.

    Raises:
        InputError: an observed image has a camera model that is not supported.
    """
    errors, behind = reprojection_errors(problem, cheirality=cheirality, num_threads=num_threads)
    return worst_of_errors(problem, errors, behind, cheirality, most=most)


def worst_of_errors(
    problem: Problem,
    errors: NDArray[np.float64],
    behind: NDArray[np.bool_],
    cheirality: str = "auto",
    *,
    most: int = WORST,
) -> tuple[ImageError, ...]:
    """Return the worst images from the output of `reprojection_errors`."""
    cheirality = resolve_cheirality(problem, cheirality)
    return worst_of_sums(
        problem,
        *sums_of_images(problem.observation_image, problem.num_images, errors, behind, cheirality),
        most,
    )


def sums_of_images(
    observation_image: NDArray[np.int32],
    num_images: int,
    errors: NDArray[np.float64],
    behind: NDArray[np.bool_],
    cheirality: str,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return for each image the number, sum of squares and maximum of the errors that count.

    `cheirality` is the resolved value with which `behind` was computed.
    """
    count = np.zeros(num_images, dtype=np.int64)
    total, largest = np.zeros(num_images), np.zeros(num_images)
    with np.errstate(over="ignore", invalid="ignore"):
        for first in range(0, len(errors), _BLOCK):
            block = slice(first, first + _BLOCK)
            counted = counted_errors(errors[block], behind[block], cheirality)
            image = observation_image[block][counted].astype(np.intp)
            its_errors = errors[block][counted]
            count += np.bincount(image, minlength=num_images)
            np.add.at(total, image, its_errors**2)
            np.maximum.at(largest, image, its_errors)
    return count, total, largest


def worst_of_sums(
    problem: Problem,
    count: NDArray[np.int64],
    total: NDArray[np.float64],
    largest: NDArray[np.float64],
    most: int = WORST,
) -> tuple[ImageError, ...]:
    """Return the images with the largest RMSE, from the output of `sums_of_images`."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        rmse = np.sqrt(total / count)
    seen = np.flatnonzero(count)
    worst = seen[np.argsort(-rmse[seen], kind="stable")][:most]
    return tuple(
        ImageError(
            image_id=int(problem.image_ids[index]),
            name=problem.image_names[index],
            num_observations=int(count[index]),
            rmse=float(rmse[index]),
            max=float(largest[index]),
        )
        for index in worst
    )
