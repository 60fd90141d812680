"""Division of points among processes.

Points are sorted by the first image that sees them, then by the last one. This order is cut where
the observations so far are k/N of all. So

- each process has as many observations as any other, up to one track,
- the points of a process are seen by images that follow each other, as far as points are at all:
  its part of the reduced camera system has few blocks that others have, too,
- the division depends on the problem and N alone: runs with as many processes are equal.

The same order is cut in K parts for the core (cpp/core/sums/point_sections.h), which sums up one
such section after the other: where N divides K, a process has whole sections, and sums have the
bits of one process.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.errors import InputError
from bundle.model.problem import Problem

__all__ = [
    "Division",
    "ProblemPart",
    "divide",
    "divide_tracks",
    "factors_of",
    "part_of",
    "shared_of",
]

# What a part has of the whole problem as it is; rigs only where there are some.
_SHARED = (
    *("cam_from_world", "image_ids", "image_camera", "image_names"),
    *("camera_ids", "camera_models", "camera_params", "camera_sizes"),
    *("rig_from_world", "sensor_from_rig", "image_frame", "image_sensor"),
    *("frame_ids", "frame_rig_ids", "sensor_rig_ids", "sensor_camera_ids"),
)


_OWN = (
    *("points", "point_ids", "observation_image", "observation_point"),
    *("observation_xy", "observation_keypoint", "observation_sigma"),
)


@dataclass(frozen=True)
class Division:
    """Points divided among processes.

    Attributes:
        parts: indices of the points of each process, ascending.
        section: (num_points,) of each point.
    """

    parts: list[NDArray[np.int64]]
    section: NDArray[np.uint16]


def divide(problem: Problem, num_parts: int) -> Division:
    """Return the points of each part.

    Raises:
        InputError: there are fewer points than parts.
    """
    num_points = problem.num_points
    image, point = problem.observation_image, problem.observation_point
    first = np.full(num_points, problem.num_images, np.int64)
    last = np.full(num_points, -1, np.int64)
    np.minimum.at(first, point, image)
    np.maximum.at(last, point, image)
    return divide_tracks(first, last, np.bincount(point, minlength=num_points), num_parts)


def divide_tracks(
    first: NDArray[Any], last: NDArray[Any], seen: NDArray[Any], num_parts: int
) -> Division:
    """Return the same from the first and the last image and the observations of each point.

    Raises:
        InputError: there are fewer points than parts.
    """
    num_points = len(seen)
    if num_points < num_parts:
        raise InputError(
            f"mpirun: expected at most as many processes as points ({num_points}), "
            f"found {num_parts}"
        )
    order = np.lexsort((last, first))
    of_each = np.asarray(seen, np.int64)[order]
    before = np.cumsum(of_each) - of_each
    total = max(int(of_each.sum()), 1)

    def place(count: int) -> NDArray[np.int64]:
        return np.asarray(np.minimum(before * count // total, count - 1), np.int64)

    section = np.empty(num_points, np.uint16)
    section[order] = place(_core.num_point_sections(total))
    cuts = np.searchsorted(place(num_parts), np.arange(1, num_parts))
    at_least = np.arange(1, num_parts)  # a point for each
    cuts = np.clip(cuts, at_least, num_points - num_parts + at_least)
    cuts = np.maximum.accumulate(cuts - at_least) + at_least
    return Division([np.sort(part) for part in np.split(order, cuts)], section)


@dataclass
class ProblemPart:
    """The arrays of a problem that the core reads, with some of its points; see ``Problem``."""

    points: NDArray[np.float64]
    point_ids: NDArray[np.int64]
    point_section: NDArray[np.uint16]
    observation_image: NDArray[np.int32]
    observation_point: NDArray[np.int32]
    observation_xy: NDArray[np.float64]
    observation_keypoint: NDArray[np.int32]
    observation_sigma: NDArray[np.float64] | None
    shared: dict[str, Any]

    def __getattr__(self, name: str) -> Any:
        if name != "shared" and name in self.shared:
            return self.shared[name]
        raise AttributeError(name)


def shared_of(problem: Problem) -> dict[str, Any]:
    """Return what a part has of the whole problem as it is."""
    return {name: getattr(problem, name) for name in _SHARED}


def part_of(
    problem: Problem, points: NDArray[np.int64], section: NDArray[np.uint16]
) -> ProblemPart:
    """Return the part of a problem that has these points, ascending indices; sections of all."""
    mine = problem.select(points=points).problem
    own = {name: getattr(mine, name) for name in _OWN}
    return ProblemPart(**own, point_section=section[points], shared=shared_of(problem))


def factors_of(core: Any, points: NDArray[np.int64]) -> tuple[Any, list[int]]:
    """Return the factors of a part, as ``_core.solve_part`` takes them, and which of all they are.

    These are all but those of points that others have.

    Args:
        core: variables, factors and places of the whole problem, or None.
        points: those of the part, ascending indices.

    Raises:
        InputError: a factor has several points, which may be in different parts.
    """
    if core is None:
        return None, []
    variables, factors, places = core
    point_of = {v: index for v, (kind, index) in enumerate(places) if kind == "point"}
    place = {index: i for i, index in enumerate(points.tolist())} if point_of else {}
    kept: list[int] = []
    for number, factor in enumerate(factors):
        its_points = {point_of[v] for v in factor[2] if v in point_of}
        if len(its_points) > 1:
            raise InputError(
                f"{factor[1]}: expected a factor of at most one point with several processes, "
                f"found {len(its_points)}"
            )
        if its_points <= place.keys():
            kept.append(number)
    used = sorted({v for number in kept for v in factors[number][2]})
    renumbered = {v: i for i, v in enumerate(used)}
    own_factors = [
        (*factor[:2], tuple(renumbered[v] for v in factor[2]), *factor[3:])
        for factor in (factors[number] for number in kept)
    ]
    own_places = [
        ("point", place[point_of[v]]) if v in point_of else tuple(places[v]) for v in used
    ]
    if not kept:
        return None, []
    return ([variables[v] for v in used], own_factors, own_places), kept
