"""How the observations of a problem differ from those of the reconstruction that it comes from.

COLMAP knows an observation by image and keypoint: an observation of the problem is the source's if
both agree, and it may have another point or position. Keypoints of an image of the source keep
their indices, for databases and descriptors refer to them; an observation without an index becomes
a new keypoint after them. Images that the source has not hold the observed keypoints only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.model.problem import Problem

__all__ = ["Baseline", "ObservationEdits", "find_edits"]

_Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Baseline:
    """Registered images, points and observations of a reconstruction.

    Ids ascend. Observations hold images and points by position in the order of their ids and are
    sorted by point, image, keypoint.
    """

    image_ids: NDArray[np.int64]
    point_ids: NDArray[np.int64]
    image: NDArray[np.int32]
    point: NDArray[np.int32]
    keypoint: NDArray[np.int32]
    xy: NDArray[np.float64]


@dataclass(frozen=True)
class ObservationEdits:
    """What has to happen to the source's keypoints and tracks.

    Attributes:
        keypoint: (num_observations,) where each observation of the problem goes in its image.
        detached: observations of the baseline whose keypoint loses a point that stays.
        attached: observations of the problem whose keypoint gets its point.
        moved: observations of the problem whose keypoint is in the source, maybe elsewhere.
        appended: observations of the problem that become keypoints of an image of the source, in
            the order of their indices.
        num_renumbered: observations whose index among the keypoints is not the problem's.
    """

    keypoint: _Indices
    detached: _Indices
    attached: _Indices
    moved: _Indices
    appended: _Indices
    num_renumbered: int


def find_edits(problem: Problem, baseline: Baseline, num_keypoints: _Indices) -> ObservationEdits:
    """Compare a problem with its source.

    Args:
        problem: the problem.
        baseline: of its source, empty if it has none.
        num_keypoints: (num_images,) keypoints that each image of the problem has in the source;
            -1 for an image that is not in it.

    Raises:
        InputError: a keypoint index is beyond those of the image, or there twice.
    """
    if _is_same(problem, baseline):
        moved = np.flatnonzero((problem.observation_xy != baseline.xy).any(axis=1))
        none = np.empty(0, np.int64)
        keypoint = problem.observation_keypoint.astype(np.int64)
        return ObservationEdits(keypoint, none, none, moved, none, 0)

    capacity = num_keypoints[problem.observation_image]
    _check_capacity(problem, capacity)
    keys, observations = _sorted_keys(problem)

    # The baseline's observations among the problem's.
    image = _rows_of(baseline.image_ids, problem.image_ids)[baseline.image].astype(np.int64)
    point = _rows_of(baseline.point_ids, problem.point_ids)[baseline.point]
    found = np.searchsorted(keys, image << 32 | baseline.keypoint)
    hit = np.append(keys, -1)[found] == (image << 32 | baseline.keypoint)
    twin = np.append(observations, 0)[found]
    stays = hit.copy()
    stays[stays] = problem.observation_point[twin[stays]] == point[stays]

    twins = twin[stays]
    is_new = np.ones(problem.num_observations, bool)
    is_new[twins] = False
    is_moved = is_new & (problem.observation_keypoint >= 0) & (capacity >= 0)
    is_moved[twins] = (problem.observation_xy[twins] != baseline.xy[stays]).any(axis=1)
    keypoint = _numbered(problem, capacity)
    given = problem.observation_keypoint >= 0
    return ObservationEdits(
        keypoint=keypoint,
        detached=np.flatnonzero(~stays & (point >= 0)),
        attached=np.flatnonzero(is_new),
        moved=np.flatnonzero(is_moved),
        appended=np.flatnonzero(~given & (capacity >= 0)),
        num_renumbered=int((given & (keypoint != problem.observation_keypoint)).sum()),
    )


def _is_same(problem: Problem, baseline: Baseline) -> bool:
    pairs = (
        (problem.image_ids, baseline.image_ids),
        (problem.point_ids, baseline.point_ids),
        (problem.observation_image, baseline.image),
        (problem.observation_point, baseline.point),
        (problem.observation_keypoint, baseline.keypoint),
    )
    return all(np.array_equal(a, b) for a, b in pairs)


def _rows_of(ids: NDArray[np.int64], among: NDArray[np.int64]) -> _Indices:
    """Return the position of each id among others, -1 where it is not there."""
    order = np.argsort(among)
    found = np.searchsorted(among, ids, sorter=order)
    rows = np.append(order, 0)[found]
    known = np.append(among, 0)[rows] == ids
    known &= found < len(among)
    return np.where(known, rows, -1)


def _check_capacity(problem: Problem, capacity: _Indices) -> None:
    beyond = (capacity >= 0) & (problem.observation_keypoint >= capacity)
    if beyond.any():
        bad = int(np.argmax(beyond))
        image_id = problem.image_ids[problem.observation_image[bad]]
        raise InputError(
            f"observation_keypoint: observation {bad}: expected one of the {capacity[bad]} "
            f"keypoints that image {image_id} has in the source, or -1 for a new one, "
            f"found {problem.observation_keypoint[bad]}"
        )


def _sorted_keys(problem: Problem) -> tuple[_Indices, _Indices]:
    """Return image and keypoint of the observations that have one, as one number that ascends."""
    given = np.flatnonzero(problem.observation_keypoint >= 0)
    image = problem.observation_image[given].astype(np.int64)
    keys = image << 32 | problem.observation_keypoint[given]
    order = np.argsort(keys, kind="stable")
    keys, given = keys[order], given[order]
    twice = np.flatnonzero(keys[1:] == keys[:-1])
    if len(twice):
        first, second = given[twice[0]], given[twice[0] + 1]
        raise InputError(
            f"observation_keypoint: observations {first} and {second}: expected each keypoint of "
            f"an image once, found keypoint {problem.observation_keypoint[first]} of image "
            f"{problem.image_ids[problem.observation_image[first]]} twice"
        )
    return keys, given


def _numbered(problem: Problem, capacity: _Indices) -> _Indices:
    """Return the keypoints' indices: new ones in the order of the observations, after the others.

    Images that the source has not are numbered without gaps, in the order of the given indices.
    """
    keypoint = problem.observation_keypoint.astype(np.int64)
    is_new = (keypoint < 0) | (capacity < 0)
    new = np.flatnonzero(is_new)
    image = problem.observation_image[new]
    last = np.where(keypoint[new] < 0, np.iinfo(np.int64).max, keypoint[new])
    order = np.lexsort((last, image))  # stable: by observation in the end
    new, image = new[order], image[order]
    counts = np.bincount(image, minlength=problem.num_images)
    rank = np.arange(len(new)) - np.repeat(np.cumsum(counts) - counts, counts)
    keypoint[new] = rank + np.maximum(capacity[new], 0)
    return keypoint
