"""Choice of the observations to hold out: seeded, stratified by image, and safe for each point.

A point may lose an observation only if two other images still see it. Fold 0 of three folds
(:mod:`bundle.model.folds`) has this property, whatever part of it is held out. In each image, the
requested share is drawn from this fold. So each observation of a point in three or more images has
the same chance, and each image contributes in proportion to its observations. Beyond 30 % the draw
is from fold 0 of two folds, which needs four images of a point.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.interface.option_fields import number
from bundle.interface.validation_options import MOST_PERCENT
from bundle.io.files import Source, as_problem
from bundle.model.folds import folds_of, keys, mix
from bundle.model.problem import Problem

FEWEST_OF_IMAGE = 6
"""Number of observations that remain in each image: twice as many as a pose needs."""

_IN_THREE_FOLDS = 30.0


def hold_out(
    problem: Source, percent: float = 10.0, seed: int = 0
) -> tuple[Problem, NDArray[np.int64]]:
    """Divide the observations of a problem into those to fit and those to predict.

    The choice is random but depends only on the seed and on the ids of images and points. Each
    image loses the same share of its observations, as far as possible. Each point keeps
    observations in at least two images, and each image keeps at least six observations. Several
    observations of a point in one image stay together.

    Args:
        problem: the problem, which is not changed; also the path of one, or a
            pycolmap.Reconstruction.
        percent: share of the observations to hold out, above 0 and at most 50. Fewer are held out
            if many points are seen by two images only.
        seed: whole number; another seed gives another choice.

    Returns:
        The problem without the held-out observations, with all its images and points; and the
        indices of the held-out observations in the given problem, ascending.

    Raises:
        InputError: a number is out of range, or no observation can be held out.
        OSError: the path cannot be read.

    Example:
        >>> kept, held = bundle.hold_out(problem, percent=10)
        >>> fitted = bundle.solve(kept).problem
        >>> fields = ("cam_from_world", "camera_params", "points", "rolling_shutter")
        >>> predicted = problem.replace(**{name: getattr(fitted, name) for name in fields})
        >>> errors, _ = bundle.reprojection_errors(predicted)
        >>> errors[held]
    """
    problem = as_problem(problem)
    held = choose(problem, percent, seed)
    return problem.select(observations=~held).problem, np.flatnonzero(held)


def choose(
    problem: Problem,
    percent: float,
    seed: int = 0,
    among: NDArray[np.bool_] | None = None,
    name: str = "percent",
) -> NDArray[np.bool_]:
    """Return a mask of the observations to hold out.

    Args:
        problem: the problem.
        percent: share of each image's observations, above 0 and at most 50.
        seed: whole number.
        among: mask of the observations that may be held out; None: all.
        name: name of the share, for errors.

    Raises:
        InputError: a number is out of range, or no observation can be held out.
    """
    percent = number(name, percent, above=0.0, maximum=MOST_PERCENT)
    seed = int(number("seed", seed, minimum=0, whole=True))
    candidates = folds_of(problem, 3 if percent <= _IN_THREE_FOLDS else 2, seed) == 0
    counted = problem.observation_image
    if among is not None:
        candidates &= among
        counted = counted[among]
    seen = np.bincount(counted, minlength=problem.num_images)
    quota = np.floor(seen * percent / 100 + 0.5).astype(np.int64)
    quota = np.minimum(quota, np.maximum(seen - FEWEST_OF_IMAGE, 0))
    rows = np.flatnonzero(candidates)
    image, point = problem.observation_image[rows], problem.observation_point[rows]
    # A second mix: the rank of an image at its point depends on the key itself.
    draw = mix(keys(seed, problem.image_ids[image], problem.point_ids[point]))
    order = np.lexsort((draw, image))
    image, draw, rows = image[order], draw[order], rows[order]
    place = np.arange(len(rows))
    begins = np.searchsorted(image, np.arange(problem.num_images))
    same = np.zeros(len(rows), bool)  # as the observation before: the same point in the same image
    same[1:] = (image[1:] == image[:-1]) & (draw[1:] == draw[:-1])
    place = np.maximum.accumulate(np.where(same, 0, place))
    held = np.zeros(problem.num_observations, bool)
    held[rows[place - begins[image] < quota[image]]] = True
    if not held.any():
        images = 3 if percent <= _IN_THREE_FOLDS else 4
        if len(rows) and quota.max() == 0 and seen.max() > FEWEST_OF_IMAGE:
            raise InputError(
                f"{name}: expected a share of one observation or more in an image, found "
                f"{percent:g} % of at most {seen.max()}"
            )
        raise InputError(
            f"{name}: expected observations to hold out {percent:g} % of, found 0 in images of "
            f"more than {FEWEST_OF_IMAGE} observations, of points that {images} images see"
        )
    return held
