"""Observations by point: track lengths, connected components, shared points."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import distinct
from bundle.base.components import component_roots
from bundle.model.problem import Problem

FEW_SHARED = 5
"""Number of common points below which two images leave their relative pose undetermined."""

Ints = NDArray[np.int64]


class TrackTable:
    """Images of each point without repeats, sorted by point.

    Attributes:
        images: (n,) image of each pair of a point and an image that observes it.
        points: (n,) point of each pair, ascending.
    """

    def __init__(self, problem: Problem) -> None:
        size = max(problem.num_images, 1)
        code = problem.observation_point.astype(np.int64) * size + problem.observation_image
        code.sort()
        self.points, self.images = np.divmod(code[np.diff(code, prepend=-1) != 0], size)
        self._problem = problem

    @cached_property
    def lengths(self) -> Ints:
        """Number of images of each point, (num_points,)."""
        return np.bincount(self.points, minlength=self._problem.num_points)

    @cached_property
    def pieces(self) -> NDArray[np.int32]:
        """Component of each image; the largest is 0; -1 for images without observations.

        Points connect the images that observe them; frames of rigs connect their images.
        """
        return self._pieces(self.images, self.points)

    @cached_property
    def shared(self) -> Ints:
        """Number of points of each image that another image also observes, (num_images,)."""
        counts = self.lengths[self.points] > 1
        return np.bincount(self.images[counts], minlength=self._problem.num_images)

    @cached_property
    def firm_pieces(self) -> NDArray[np.int32]:
        """Components as in ``pieces``, where five shared points are needed for a connection."""
        first, second, count = self.pair_counts
        ends = np.stack([first, second], axis=1)[count >= FEW_SHARED]
        # Each pair of images is treated as one point; single images as points of one image.
        alone = distinct(self.images)
        images = np.concatenate([ends.ravel(), alone])
        points = np.concatenate(
            [np.repeat(np.arange(len(ends)), 2), len(ends) + np.arange(len(alone))]
        )
        return self._pieces(images, points)

    @cached_property
    def rigid_pieces(self) -> NDArray[np.int32]:
        """Components as in ``pieces``, connected only by points that three images see."""
        chosen = self.lengths[self.points] > 2
        alone = distinct(self.images)
        last = self._problem.num_points
        return self._pieces(
            np.concatenate([self.images[chosen], alone]),
            np.concatenate([self.points[chosen], last + np.arange(len(alone))]),
        )

    def count_between(self, images: NDArray[Any]) -> int:
        """Return the number of points that both these images and other images observe."""
        inside = np.isin(self.images, images)
        both = np.intersect1d(self.points[inside], self.points[~inside])
        return len(both)

    @cached_property
    def pair_counts(self) -> tuple[Ints, Ints, Ints]:
        """Pairs of images on common points, first < second, and the number of these points."""
        size = max(self._problem.num_images, 1)
        first, second = self._pairs()
        code, count = np.unique(first * size + second, return_counts=True)
        return (*np.divmod(code, size), count)

    def _pairs(self) -> tuple[Ints, Ints]:
        """Return pairs of images on common points: each observation with the next ones.

        Long tracks give only pairs within ten positions: their images share many other points.
        """
        first, second = [], []
        for step in range(1, 11):
            same = np.flatnonzero(self.points[step:] == self.points[:-step])
            if not len(same):
                break
            first.append(self.images[same])
            second.append(self.images[same + step])
        if not first:
            return np.empty(0, np.int64), np.empty(0, np.int64)
        return np.concatenate(first), np.concatenate(second)

    def _pieces(self, images: Ints, points: Ints) -> NDArray[np.int32]:
        problem = self._problem
        observed = np.zeros(problem.num_images, bool)
        observed[images] = True
        if problem.num_frames:
            carried = np.flatnonzero(observed & (problem.image_frame >= 0))
            by_frame = carried[np.argsort(problem.image_frame[carried], kind="stable")]
            images = np.concatenate([images, by_frame])
            last = points[-1] + 1 if len(points) else 0
            points = np.concatenate([points, last + problem.image_frame[by_frame]])
        starts = np.flatnonzero(np.diff(points, prepend=-1))
        roots = component_roots(images, starts, problem.num_images)
        piece = np.full(problem.num_images, -1, np.int32)
        _, piece[observed], sizes = np.unique(
            roots[observed], return_inverse=True, return_counts=True
        )
        order = np.argsort(-sizes, kind="stable")
        rank = np.empty(len(order), np.int32)
        rank[order] = np.arange(len(order))
        piece[observed] = rank[piece[observed]]
        return piece
