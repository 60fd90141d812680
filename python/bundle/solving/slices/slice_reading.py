"""Reading of a slice of a model: all cameras, and a process's points with their observations."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.errors import InputError, shown
from bundle.io import bal, colmap
from bundle.io.atomic.replaced_paths import ROLLING_SHUTTER
from bundle.io.rolling_shutter_file import with_rolling_shutter
from bundle.model.problem import Problem
from bundle.solving.ranks.crew import Meeting
from bundle.solving.ranks.partition import ProblemPart, divide_tracks, shared_of

_BLOCK = 1 << 20


@dataclass
class Survey:
    """Counts of a model, and the owner of each point."""

    num_images: int  # number of images of the model
    num_observations: int  # number of observations of the model
    owner: NDArray[np.uint16]  # (num_points,) rank that owns each point
    section: NDArray[np.uint16]  # (num_points,) section of each point; see ``ranks.partition``
    # (num_points,) ascending ids of a COLMAP model; None for a BAL file, whose ids are the
    # positions in the file
    point_ids: NDArray[np.int64] | None = None

    def unknown(self, ids: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the ids of which no point exists."""
        if self.point_ids is None:
            return ids[(ids < 0) | (ids >= len(self.owner))]
        return np.setdiff1d(ids, self.point_ids)


@dataclass
class Slice:
    """Slice of a model in one process."""

    cameras: Problem  # all images and cameras, without points and observations
    part: ProblemPart  # points and observations of the process
    survey: Survey  # survey of the entire model
    # (num_images,) True if any process has an observation in the image
    image_is_observed: NDArray[np.uint8]


def survey(path: Path, num_parts: int) -> Survey:
    """Read a BAL file or a binary COLMAP model once, and divide its points.

    Raises:
        InputError: the file violates its format, or has fewer points than parts. The agreement of
            tracks and keypoints of a COLMAP model is checked in :func:`read_slice`.
        OSError: a file cannot be read.
    """
    ids = None
    if path.is_dir():
        if num_parts > 1 and (path / ROLLING_SHUTTER).is_file():
            raise InputError(
                f"{shown(path)}: expected a model without a rolling shutter, which slices of "
                f"several processes do not support, found {ROLLING_SHUTTER}"
            )
        found = _core.survey_colmap_model(os.fsencode(path))
        num_images, num_observations, ids, first, last, seen = found
    elif num_parts == 1 and (header := _bal_header(path)) is not None:
        num_images, num_points, num_observations = header
        nobody = np.broadcast_to(np.uint16(0), num_points)
        return Survey(num_images, num_observations, nobody, nobody)
    else:
        num_images, num_observations, first, last, seen = _core.survey_bal(path)
    if num_parts == 1:  # the only process has all points and sections
        nobody = np.broadcast_to(np.uint16(0), len(seen))
        return Survey(num_images, num_observations, nobody, nobody, ids)
    owner = np.zeros(len(seen), np.uint16)
    section = np.zeros(len(seen), np.uint16)
    if num_observations:
        division = divide_tracks(first, last, seen, num_parts)
        section = division.section
        for number, points in enumerate(division.parts):
            owner[points] = number
    return Survey(num_images, num_observations, owner, section, ids)


def read_slice(meeting: Meeting, path: Path, found: Survey | None) -> Slice:
    """Read the slice of this process; ``found`` is the survey on rank 0, None on other ranks."""
    whole: Survey = meeting.broadcast(found)
    if meeting.num_ranks == 1:
        mine, place = (_counted_up(len(whole.owner), kind) for kind in (np.int64, np.int32))
    else:
        mine = np.flatnonzero(whole.owner == meeting.rank)
        place = np.full(len(whole.owner), -1, np.int32)
        place[mine] = np.arange(len(mine), dtype=np.int32)
    if whole.point_ids is None:
        cameras, part = _bal_slice(path, mine, place, whole.section)
    else:
        given = _colmap_slice(path, whole.point_ids, mine, place, whole.section)
        cameras, part, failure = given
        failures = sorted(filter(None, meeting.gather(failure) or ()))
        if failures:
            raise InputError(failures[0][-1])
    counts = meeting.gather(_counts(part.observation_image, cameras.num_images))
    observed = None
    if counts is not None:
        total = sum(counts)
        if total.sum() != whole.num_observations:
            raise InputError(
                f"{shown(path)}: expected the same file in all processes, found "
                f"{whole.num_observations} observations in process 0 and {total.sum()} in all parts"
            )
        observed = (total > 0).astype(np.uint8)
    return Slice(cameras, part, whole, meeting.broadcast(observed))


def _bal_header(path: Path) -> tuple[int, int, int] | None:
    """Return the counts of images, points and observations; None unless line 1 has just these."""
    with path.open("rb") as file:
        words = file.readline(100).split()
    counts = [int(word) for word in words if word.isdigit() and len(word) < 10]
    return (counts[0], counts[1], counts[2]) if len(words) == len(counts) == 3 else None


def blocks(size: int) -> Iterator[slice]:
    """Yield slices of an array that may be larger than the memory."""
    return (slice(begin, begin + _BLOCK) for begin in range(0, size, _BLOCK))


def _counted_up(size: int, kind: type[Any]) -> NDArray[Any]:
    """Return 0, 1, 2, ..., in the scratch folder if one is open."""
    numbers = _core.large_array(size, np.dtype(kind))
    for block in blocks(size):
        numbers[block] = np.arange(block.start, min(block.stop, size))
    return numbers


def _counts(image: NDArray[np.int32], num_images: int) -> NDArray[np.int64]:
    """Return the number of observations of each image."""
    counts = np.zeros(num_images, np.int64)
    for block in blocks(len(image)):
        counts += np.bincount(image[block], minlength=num_images)
    return counts


def _bal_slice(
    path: Path, mine: NDArray[np.int64], place: NDArray[np.int32], section: NDArray[np.uint16]
) -> tuple[Problem, ProblemPart]:
    poses, rotations, params, points, image, point, xy = _core.read_bal_part(path, place)
    none, nowhere = np.zeros(0, np.int32), np.zeros((0, 2))
    cameras = bal.problem_of(poses, rotations, params, np.zeros((0, 3)), none, none, nowhere)
    keypoint = np.full(len(xy), -1, np.int32) if len(section) > len(mine) else None
    sections = section[mine] if len(mine) < len(section) else section
    return cameras, _part(cameras, points, mine, sections, image, point, xy, keypoint)


def _colmap_slice(
    path: Path,
    ids: NDArray[np.int64],
    mine: NDArray[np.int64],
    place: NDArray[np.int32],
    section: NDArray[np.uint16],
) -> tuple[Problem, ProblemPart, tuple[int, int, str] | None]:
    model, fields, failure = _core.read_colmap_part(os.fsencode(path), ids, place)
    names = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    points, *observations = (fields[name] for name in ("points", *names))
    nothing = {name: np.array(fields[name][:0]) for name in ("points", *names)}
    cameras = colmap.problem_of(path, model, fields | nothing | {"point_ids": ids[:0]})
    cameras = with_rolling_shutter(cameras, path)
    if len(mine) == len(ids):
        part = _part(cameras, points, ids, section, *observations)
        part.observation_keypoint = None
        return cameras, part, failure
    return cameras, _part(cameras, points, ids[mine], section[mine], *observations), failure


def _part(
    cameras: Problem,
    points: NDArray[np.float64],
    point_ids: NDArray[np.int64],
    point_section: NDArray[np.uint16],
    image: NDArray[np.int32],
    point: NDArray[np.int32],
    xy: NDArray[np.float64],
    keypoint: NDArray[np.int32] | None,
) -> ProblemPart:
    return ProblemPart(
        points=points,
        point_ids=point_ids,
        point_section=point_section,
        observation_image=image,
        observation_point=point,
        observation_xy=xy,
        observation_keypoint=keypoint,
        observation_sigma=None,
        shared=shared_of(cameras),
    )
