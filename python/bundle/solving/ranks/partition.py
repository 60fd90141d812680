"""Division of points among processes, and the solves that are not divided.

Points are sorted by the first image that sees them, then by the last one. This order is cut for N
processes where the cumulative number of observations reaches k/N of all. Therefore

- all processes have the same number of observations, up to one track;
- the points of a process are mostly seen by consecutive images, so that its part of the reduced
  camera system shares few blocks with other processes;
- the division depends on the problem and N only: runs with the same number of processes are equal.

The same order is cut into K sections for the core (cpp/core/sums/point_sections.h), which adds up
one section after the other. If N divides K, each process has complete sections, and sums are equal
bit for bit to those of one process.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.model.estimates import SHUTTER, VARIABLES
from bundle.model.problem import Problem

# Arrays of the full problem that each part has unchanged, beside the shared variables; arrays of
# rigs only if it has rigs.
_SHARED = (
    *("image_ids", "image_camera", "image_names", "camera_ids", "camera_models", "camera_sizes"),
    *("image_frame", "image_sensor"),
    *("frame_ids", "frame_rig_ids", "sensor_rig_ids", "sensor_camera_ids"),
    SHUTTER,
)


_OWN = (
    *("point_ids", "observation_image", "observation_point"),
    *("observation_xy", "observation_keypoint", "observation_sigma"),
)


@dataclass(frozen=True)
class Division:
    """Points divided among processes."""

    parts: list[NDArray[np.int64]]  # indices of the points of each process, ascending
    section: NDArray[np.uint16]  # (num_points,) section of each point


def divide(problem: Problem, num_parts: int) -> Division:
    """Return the points of each part."""
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
    """Return the division from each point's first image, last image and number of observations."""
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
    at_least = np.arange(1, num_parts)  # at least one point per part
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
    observation_keypoint: NDArray[np.int32] | None  # None: not needed, all is in one process
    observation_sigma: NDArray[np.float64] | None
    shared: dict[str, Any]

    def __getattr__(self, name: str) -> Any:
        if name != "shared" and name in self.shared:
            return self.shared[name]
        raise AttributeError(name)

    def _moved(self, **state: Any) -> ProblemPart:
        """Return a copy with other arrays, which must be immutable and valid."""
        own = {name: state[name] for name in state if name in vars(self)}
        shared = {name: state[name] for name in state if name not in own}
        return dataclasses.replace(self, **own, shared=self.shared | shared)


def _variables(division: str) -> list[str]:
    return [one.name for one in VARIABLES if one.division == division]


def shared_of(problem: Problem) -> dict[str, Any]:
    """Return the arrays that are equal in the full problem and in each part."""
    return {name: getattr(problem, name) for name in (*_variables("shared"), *_SHARED)}


def part_of(
    problem: Problem, points: NDArray[np.int64], section: NDArray[np.uint16]
) -> ProblemPart:
    """Return the part of a problem with these points.

    The indices of the points are ascending; the sections are those of all points.
    """
    mine = problem.select(points=points).problem
    own = {name: getattr(mine, name) for name in (*_variables("own"), *_OWN)}
    return ProblemPart(**own, point_section=section[points], shared=shared_of(problem))


def factors_of(core: Any, points: NDArray[np.int64]) -> tuple[Any, list[int]]:
    """Return the factors of a part in the form of ``_core.solve_part``, and their indices.

    These are all factors except those on points of other parts.

    ``core``: variables, factors and places of the full problem, or None. ``points``: ascending
    indices of the points of the part.
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


# Solves that rank 0 runs alone while the other ranks wait, and the reasons.
#
# The fused backend divides points among ranks. A solve by Ceres is not divided. A solve that needs
# points of several ranks at once is not divided either: three points that fix the gauge, or a
# factor of several points.

_OPEN = ("gauge", "cheirality")
"""Options that depend on the problem and have no effect on the division among ranks."""


def reason_in_options(options: dict[str, Any]) -> str:
    """Return why no solve with these options can be divided; "" if it can."""
    if options["gauge"] == "three_points":
        return "The three points that fix the gauge may be in different parts (gauge)."
    return _core.reason_for_ceres(options | {name: _core.default_options()[name] for name in _OPEN})


def reason_to_be_alone(options: dict[str, Any], core_factors: Any) -> str:
    """Return why a solve cannot be divided; "" if it can.

    ``core_factors``: variables, factors and places in the form of ``_core.solve``; None without
    factors.
    """
    reason = reason_in_options(options)
    if reason or core_factors is None:
        return reason
    _, factors, places = core_factors
    for factor in factors:
        kinds = [places[variable][0] for variable in factor[2]]
        if "point" in kinds and len(kinds) > 1:
            return f"{factor[1]} couples a point with another variable (factors)."
    return ""


def warning(reason: str, num_ranks: int) -> str:
    """Return the warning that a solve was not divided."""
    others = "the other one" if num_ranks == 2 else f"the other {num_ranks - 1}"
    return f"One process solved, and {others} waited. {reason}"
