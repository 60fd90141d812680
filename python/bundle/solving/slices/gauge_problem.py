"""Gauge problem of a model in slices: a small problem with the same gauge freedom.

Gauge freedom (``bundle.solving.gauge_freedom``) depends on the images that free points connect, and
on the positions of constant points. For free points, a slice therefore contributes one point per
observed image, which connects the image with the first image of its component. For constant points
it contributes all observations. The gauge problem therefore consists of at most one free point per
image from each process, and of the constant points that the user named.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.components import component_roots
from bundle.model.problem import Problem
from bundle.solving.slices.slice_reading import Meeting, Slice


def gauge_problem(meeting: Meeting, own: Slice, fixed_point_ids: list[int]) -> Problem | None:
    """Return a problem with the same gauge freedom to rank 0, None to the other ranks.

    Args:
        meeting: communication of all processes.
        own: slice of this process.
        fixed_point_ids: constant points of all slices.
    """
    given = meeting.gather(_of_slice(own, np.asarray(fixed_point_ids, np.int64)))
    if given is None:
        return None
    links, held_images, held_points, positions, ids = (
        np.concatenate(columns) for columns in zip(*given, strict=True)
    )
    first = np.cumsum([0, *(len(of[-1]) for of in given)])
    held_points = held_points + np.repeat(first[:-1], [len(of[1]) for of in given])
    free_ids = np.arange(len(links)) + 1 + max(fixed_point_ids, default=0)
    image = np.r_[held_images, links.ravel()].astype(np.int32)
    return own.cameras.replace(
        points=np.r_[positions, np.zeros((len(links), 3))],
        point_ids=np.r_[ids, free_ids],
        observation_image=image,
        observation_point=np.r_[held_points, len(ids) + np.repeat(np.arange(len(links)), 2)],
        observation_xy=np.zeros((len(image), 2)),
        observation_keypoint=np.full(len(image), -1, np.int32),
    )


def _of_slice(own: Slice, fixed: NDArray[np.int64]) -> tuple[NDArray[Any], ...]:
    """Return the connected images; and images, rows, positions and ids of the constant points."""
    part = own.part
    is_held = np.isin(part.point_ids, fixed)
    held = np.flatnonzero(is_held[part.observation_point])
    free = np.flatnonzero(~is_held[part.observation_point])
    free = free[np.argsort(part.observation_point[free], kind="stable")]
    images, points = part.observation_image[free], part.observation_point[free]
    starts = np.flatnonzero(np.diff(points, prepend=-1))
    roots = component_roots(images, starts, own.cameras.num_images)
    seen = np.unique(images)
    row = np.cumsum(is_held) - 1
    return (
        np.stack([seen, roots[seen]], axis=1),
        part.observation_image[held],
        row[part.observation_point[held]],
        part.points[is_held],
        part.point_ids[is_held],
    )
