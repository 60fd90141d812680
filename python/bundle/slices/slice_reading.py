"""A process reads its slice of a BAL file: all cameras, its points, their observations."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.errors import InputError, shown
from bundle.io import bal
from bundle.problem import Problem
from bundle.ranks.divided_solve import Ranks
from bundle.ranks.partition import ProblemPart, divide_tracks, shared_of

__all__ = ["Meeting", "Slice", "Survey", "read_slice", "survey"]


class Meeting(Protocol):
    """All processes, in the same order of calls."""

    rank: int
    num_ranks: int

    def broadcast(self, value: Any = None) -> Any:
        """Return the value of the first."""

    def gather(self, value: Any) -> list[Any]:
        """Return the values of all to the first, nothing to the others."""

    def ranks(self) -> Ranks:
        """Return how the core meets the others in one solve."""


@dataclass
class Survey:
    """What a file has, and which point is whose.

    Attributes:
        num_images: of the file.
        num_observations: of the file.
        owner: (num_points,) the process that has a point.
    """

    num_images: int
    num_observations: int
    owner: NDArray[np.uint16]


@dataclass
class Slice:
    """What one process has of a file.

    Attributes:
        cameras: all images and cameras, without points and observations.
        part: its points and observations.
        points: their indices in the file, ascending.
        survey: of the whole file.
        image_is_observed: (num_images,) by any process.
    """

    cameras: Problem
    part: ProblemPart
    points: NDArray[np.int64]
    survey: Survey
    image_is_observed: NDArray[np.uint8]


def survey(path: Path, num_parts: int) -> Survey:
    """Read a BAL file once and keep what tells which points belong together.

    Raises:
        InputError: the file is not what the format says, or has fewer points than parts.
        OSError: the file cannot be read.
    """
    num_images, num_observations, first, last, seen = _core.survey_bal(path)
    owner = np.zeros(len(seen), np.uint16)
    if num_observations:
        for number, points in enumerate(divide_tracks(first, last, seen, num_parts)):
            owner[points] = number
    return Survey(num_images, num_observations, owner)


def read_slice(meeting: Meeting, path: Path, found: Survey | None) -> Slice:
    """Read the slice of this process; ``found`` is the first one's survey, None elsewhere.

    Raises:
        InputError: the file is not the one that was surveyed, as far as counts tell.
        OSError: the file cannot be read.
    """
    whole: Survey = meeting.broadcast(found)
    mine = np.flatnonzero(whole.owner == meeting.rank)
    place = np.full(len(whole.owner), -1, np.int32)
    place[mine] = np.arange(len(mine), dtype=np.int32)
    poses, rotations, params, points, image, point, xy = _core.read_bal_part(path, place)
    none, nowhere = np.zeros(0, np.int32), np.zeros((0, 2))
    cameras = bal.problem_of(poses, rotations, params, points[:0], none, none, nowhere)
    part = ProblemPart(
        points=points,
        point_ids=mine,
        observation_image=image,
        observation_point=point,
        observation_xy=xy,
        observation_keypoint=np.full(len(xy), -1, np.int32),
        observation_sigma=None,
        shared=shared_of(cameras),
    )
    counts = meeting.gather(np.bincount(image, minlength=len(poses)))
    observed = None
    if counts is not None:
        total = sum(counts)
        if total.sum() != whole.num_observations:
            raise InputError(
                f"{shown(path)}: expected the same file in all processes, found "
                f"{whole.num_observations} observations in process 0 and {total.sum()} in all parts"
            )
        observed = (total > 0).astype(np.uint8)
    return Slice(cameras, part, mine, whole, meeting.broadcast(observed))
