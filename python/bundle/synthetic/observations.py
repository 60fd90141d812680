"""Observations of a scene: points that an image can observe, selection among them, noise."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.components import component_roots
from bundle.errors import InputError
from bundle.interface.scene_options import (
    MIN_OBSERVATIONS_PER_IMAGE,
    MIN_TRACK_LENGTH,
    SceneOptions,
)
from bundle.synthetic.scene import Intrinsics, Pairs, Points, Scene

# Visibility: the points that an image can observe.
#
# A point is visible if all conditions hold: its key is in the ball of the image, the camera is
# within its reach, its surface faces the camera, it projects into the image, and nothing occludes
# it. Often far more images see a point than its track needs. Pairs are then thinned at random
# before these tests, evenly within the image's ball, so that the work is proportional to the
# requested observations. The C++ core does this (``cpp/core/synthetic``).
#
# Points are sorted into a uniform grid. Only occupied cells are stored.

Array = NDArray[np.float64]


class Cells:
    """Points by grid cell.

    Attributes:
        centers: (num_cells, 3) centres of the cells.
        half_diagonal: half the diagonal of a cell.
    """

    order: NDArray[np.int64]  # (n,) points, cell by cell
    starts: NDArray[np.int64]  # (num_cells + 1,) begin of each cell in ``order``

    def __init__(self, keys: Array, size: float) -> None:
        grid = np.floor((keys - keys.min(axis=0)) / size).astype(np.int64)
        extent = grid.max(axis=0) + 1
        code = (grid[:, 0] * extent[1] + grid[:, 1]) * extent[2] + grid[:, 2]
        self.order = np.argsort(code, kind="stable")
        code = code[self.order]
        first = np.flatnonzero(np.concatenate([[True], code[1:] != code[:-1]]))
        self.starts = np.append(first, len(code))
        self.centers = (grid[self.order[first]] + 0.5) * size + keys.min(axis=0)
        self.half_diagonal = 0.5 * float(np.sqrt(3.0)) * size

    def __len__(self) -> int:
        return len(self.starts) - 1


# About a third of the thinned pairs are visible, and a track needs some choice of images.
_PAIRS_PER_OBSERVATION = 6.0
# Beyond this multiple of the image corner, distortion polynomials may fold back into the image.
_FIELD_MARGIN = 1.15


class Visibility:
    """Tests of visibility in the images of a scene, with their true cameras."""

    def __init__(self, scene: Scene, intrinsics: Intrinsics) -> None:
        images = scene.images
        sizes = images.sizes.astype(np.float64)
        corners = 0.5 * np.hypot(sizes[:, 0], sizes[:, 1]) / (images.focal * sizes.max(axis=1))
        self._cell_size = 0.5 * float(np.median(images.ball_radii))
        self._images = _core.SyntheticImages(
            images.centers,
            images.rotations,
            images.ball_centers,
            images.ball_radii,
            _FIELD_MARGIN * corners,
            sizes,
            images.richness,
            intrinsics.image_camera,
            intrinsics.params,
            intrinsics.model,
            scene.min_cosine,
            *scene.blocks,
        )

    def pairs(
        self, rng: np.random.Generator, points: Points, lengths: Array, num_threads: int = 0
    ) -> Pairs:
        """Return the possible observations.

        ``lengths``: (n,) wanted number of observations of each point. ``num_threads``: number of
        threads; 0: all cores. The pairs do not depend on it.
        """
        cells = Cells(points.keys, self._cell_size)
        by_cell = points.take(cells.order)
        point, image = self._images.visible_pairs(
            by_cell.positions,
            by_cell.normals,
            by_cell.reach,
            by_cell.keys,
            cells.centers,
            cells.half_diagonal,
            cells.starts,
            cells.order,
            _PAIRS_PER_OBSERVATION * lengths[cells.order],
            10 * MIN_OBSERVATIONS_PER_IMAGE,
            rng.bit_generator.capsule,
            num_threads,
        )
        return Pairs.from_sorted(point, image, len(points))

    def pixels(
        self,
        positions: Array,
        observation_image: NDArray[np.int32],
        observation_point: NDArray[np.int32],
        num_threads: int = 0,
    ) -> Array:
        """Return the exact projections (M, 2) [pixels] of observed points at positions (n, 3)."""
        return self._images.exact_pixels(
            positions, observation_image, observation_point, num_threads
        )


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
        may_be_shorter: accept a smaller mean length if images cannot observe more points.

    Returns:
        Selected pairs. Images with few observations get up to 20 if possible, and all images are
        connected.
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


def measure(
    rng: np.random.Generator, xy: Array, sizes: NDArray[np.int64], options: SceneOptions
) -> tuple[Array, NDArray[np.bool_]]:
    """Return measured positions (M, 2) in pixels, and the mask of outliers (M,).

    If noise would move an observation out of the image, its sign is reversed. This preserves its
    magnitude.

    Args:
        xy: (M, 2) exact positions.
        sizes: (M, 2) width and height of the image of each observation.
    """
    noise = options.pixel_noise * rng.standard_normal(xy.shape)
    measured = xy + noise
    measured = np.where((measured < 0) | (measured > sizes), xy - noise, measured)
    outliers = rng.permutation(len(xy))[: round(options.outlier_share * len(xy))]
    measured[outliers] = rng.random((len(outliers), 2)) * sizes[outliers]
    is_outlier = np.zeros(len(xy), dtype=np.bool_)
    is_outlier[outliers] = True
    return measured, is_outlier
