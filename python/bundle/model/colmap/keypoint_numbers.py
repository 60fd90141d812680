"""Indices of the observations of a problem among the keypoints of a COLMAP model.

COLMAP identifies an observation by image and keypoint. Keypoints of source images keep their
indices, because databases and descriptors refer to them. An observation without an index becomes a
new keypoint after them. Images that the source does not have contain only observed keypoints.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.model.problem_arrays import ProblemArrays

_Indices = NDArray[np.int64]


@dataclass(frozen=True)
class KeypointNumbers:
    """Keypoints of the observations of a problem.

    Attributes:
        keypoint: (num_observations,) index of each observation in its image.
        num_keypoints: (num_images,) number of keypoints of each image, including new keypoints.
        num_renumbered: number of observations with another index than in the problem.
    """

    keypoint: _Indices
    num_keypoints: _Indices
    num_renumbered: int


def number_keypoints(problem: ProblemArrays, num_keypoints: _Indices) -> KeypointNumbers:
    """Number the keypoints of a problem.

    Args:
        problem: the problem.
        num_keypoints: (num_images,) number of keypoints of each image in the source; -1 for an
            image that is not in the source.

    Raises:
        InputError: a keypoint index is out of the image's range, or occurs twice.
    """
    capacity = num_keypoints[problem.observation_image]
    given = problem.observation_keypoint >= 0
    beyond = (capacity >= 0) & (problem.observation_keypoint >= capacity)
    if beyond.any():
        bad = int(np.argmax(beyond))
        image_id = problem.image_ids[problem.observation_image[bad]]
        raise InputError(
            f"observation_keypoint: observation {bad}: expected one of the {capacity[bad]} "
            f"keypoints that image {image_id} has in the source, or -1 for a new keypoint, found "
            f"{problem.observation_keypoint[bad]}"
        )
    _check_once(problem, np.flatnonzero(given))
    is_new = ~given | (capacity < 0)
    added = np.bincount(problem.observation_image[is_new], minlength=problem.num_images)
    keypoint = problem.observation_keypoint.astype(np.int64)
    keypoint[is_new] = _numbered(problem, np.flatnonzero(is_new), added, np.maximum(capacity, 0))
    return KeypointNumbers(
        keypoint=keypoint,
        num_keypoints=np.maximum(num_keypoints, 0) + added,
        num_renumbered=int((given & (keypoint != problem.observation_keypoint)).sum()),
    )


def _check_once(problem: ProblemArrays, given: _Indices) -> None:
    """Check that the given observations have different keypoints."""
    image = problem.observation_image[given].astype(np.int64)
    keys = image << 32 | problem.observation_keypoint[given]
    order = np.argsort(keys, kind="stable")
    twice = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    if len(twice):
        first, second = given[order[twice[0]]], given[order[twice[0] + 1]]
        raise InputError(
            f"observation_keypoint: observations {first} and {second}: expected each keypoint of "
            f"an image once, found keypoint {problem.observation_keypoint[first]} of image "
            f"{problem.image_ids[problem.observation_image[first]]} twice"
        )


def _numbered(
    problem: ProblemArrays, new: _Indices, added: _Indices, capacity: _Indices
) -> _Indices:
    """Return the indices of new keypoints: after those of the source, without gaps.

    In each image, observations with an index come first, in the order of their indices. The other
    observations follow in the order of the problem.
    """
    keypoint = problem.observation_keypoint[new].astype(np.int64)
    keypoint[keypoint < 0] = np.iinfo(np.int64).max
    order = np.lexsort((keypoint, problem.observation_image[new]))
    begins = np.repeat(np.cumsum(added) - added, added)
    numbers = np.empty(len(new), np.int64)
    numbers[order] = np.arange(len(new)) - begins
    return numbers + capacity[new]
