"""Selection of observations among the possible observations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.base.components import component_roots
from bundle.errors import InputError
from bundle.interface.scene_options import MIN_OBSERVATIONS_PER_IMAGE, MIN_TRACK_LENGTH
from bundle.synthetic.scene import Pairs

Array = NDArray[np.float64]

_REQUIRED_OBSERVATIONS = 4
_OBSERVATIONS_PER_BRIDGE = 10
# A smaller share of the requested mean track length is a failure.
_ACCEPTED_SHARE = 0.75


def wanted_lengths(weights: Array, scale: float) -> NDArray[np.int64]:
    """Return integer track lengths 2 + weights * scale (rounded)."""
    beyond = np.floor(weights * scale + 0.5)
    return MIN_TRACK_LENGTH + np.minimum(beyond, 1e9).astype(np.int64)


def select_observations(
    pairs: Pairs,
    preference: Array,
    weights: Array,
    mean_length: float,
    num_images: int,
    *,
    may_be_shorter: bool = False,
) -> Pairs:
    """Select the observations of every point among its possible observations.

    Args:
        pairs: possible observations; at least two images per point.
        preference: (M,) values of the pairs; every point gets its pairs with the smallest values.
        weights: (num_points,) wanted length of each track beyond 2, relative to other tracks.
        mean_length: mean track length to reach.
        num_images: number of images.
        may_be_shorter: accept a smaller mean length if images cannot observe more points.

    Returns:
        Selected pairs. Images with few observations get up to 20 if possible, and all images are
        connected.

    Raises:
        InputError: the images have too few common points.
    """
    lengths = _fit_lengths(pairs.counts, weights, mean_length)
    if not may_be_shorter and lengths.mean() < _ACCEPTED_SHARE * mean_length:
        raise InputError(
            f"mean_track_length: expected at most {lengths.mean():.1f}, the mean number of "
            f"images that can observe a point of this scene, found {mean_length:g}"
        )
    by_preference = np.lexsort((preference, pairs.point))
    chosen = np.zeros(len(pairs), dtype=np.bool_)
    chosen[by_preference] = pairs.ranks < np.repeat(lengths, pairs.counts)
    _fill_images(pairs, preference, chosen, num_images)
    _connect(pairs, preference, chosen, num_images)
    check_images(pairs, chosen, num_images)
    return Pairs.from_sorted(pairs.point[chosen], pairs.image[chosen], len(weights))


def _fit_lengths(
    available: NDArray[np.int64], weights: Array, mean_length: float
) -> NDArray[np.int64]:
    """Return track lengths with the requested mean, at most the available lengths."""

    def lengths(scale: float) -> NDArray[np.int64]:
        return np.minimum(wanted_lengths(weights, scale), available)

    low, high = 0.0, 1.0
    while lengths(high).mean() < mean_length and high < 1e6:
        low, high = high, 2.0 * high
    for _ in range(40):
        middle = 0.5 * (low + high)
        if lengths(middle).mean() < mean_length:
            low = middle
        else:
            high = middle
    return lengths(high)


def _fill_images(
    pairs: Pairs, preference: Array, chosen: NDArray[np.bool_], num_images: int
) -> None:
    """Add the best possible observations to images with few observations."""
    counts = np.bincount(pairs.image[chosen], minlength=num_images)
    poor = counts < MIN_OBSERVATIONS_PER_IMAGE
    spare = np.flatnonzero(poor[pairs.image] & ~chosen)
    spare = spare[np.lexsort((preference[spare], pairs.image[spare]))]
    missing = MIN_OBSERVATIONS_PER_IMAGE - counts
    chosen[spare[_ranks(pairs.image[spare]) < missing[pairs.image[spare]]]] = True


def _connect(pairs: Pairs, preference: Array, chosen: NDArray[np.bool_], num_images: int) -> None:
    """Add observations between components until only one component is left."""
    num_points = len(pairs.counts)
    while True:
        current = Pairs.from_sorted(pairs.point[chosen], pairs.image[chosen], num_points)
        of_image, of_point = components(current, num_images)
        num_components = len(np.unique(of_image))
        if num_components == 1:
            return
        bridge = np.flatnonzero(of_image[pairs.image] != of_point[pairs.point])
        if len(bridge) == 0:
            raise InputError(
                f"num_points: the scene falls into {num_components} components without common "
                "points; expected more points, longer tracks or another seed, found "
                f"{num_points} points"
            )
        link = of_image[pairs.image[bridge]] * num_images + of_point[pairs.point[bridge]]
        by_link = np.lexsort((preference[bridge], link))
        chosen[bridge[by_link[_ranks(link[by_link]) < _OBSERVATIONS_PER_BRIDGE]]] = True


def components(pairs: Pairs, num_images: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Label the connected components of the graph of images and points; its edges are the pairs.

    Every point must have a pair.

    Returns:
        Labels of the images (num_images,) and of the points (num_points,): the smallest image index
        of the component.
    """
    roots = component_roots(pairs.image, pairs.starts[:-1], num_images)
    return roots, roots[pairs.image[pairs.starts[:-1]]]


def check_images(pairs: Pairs, chosen: NDArray[np.bool_], num_images: int) -> None:
    """Raise an InputError if an image observes too few points."""
    counts = np.bincount(pairs.image[chosen], minlength=num_images)
    poorest = int(np.argmin(counts))
    if counts[poorest] < _REQUIRED_OBSERVATIONS:
        seen = int(counts[poorest])
        enough = math.ceil(len(pairs.counts) * (_REQUIRED_OBSERVATIONS + 1) / (seen + 1))
        raise InputError(
            f"num_points: expected about {enough} or more, so that each image observes "
            f"{_REQUIRED_OBSERVATIONS} points, found {len(pairs.counts)}, of which image "
            f"{poorest + 1} observes {seen}"
        )


def _ranks(groups: NDArray[np.generic]) -> NDArray[np.int64]:
    """Return the position of each entry in its group; equal entries are adjacent."""
    index = np.arange(len(groups))
    if len(groups) == 0:
        return index
    starts = np.concatenate([[True], groups[1:] != groups[:-1]])
    return index - np.maximum.accumulate(np.where(starts, index, 0))
