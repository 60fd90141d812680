"""Observations per point and angles between rays; both determine the precision of points."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.words import amount
from bundle.figures.drawing import Figure
from bundle.figures.marks import Bars
from bundle.model.problem import Problem
from bundle.model.ray_angles import enclose_angle

ANGLES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
LONGEST = 20


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackStatistics:
    """Distributions over the points.

    Attributes:
        lengths: number of points with 0, 1, ... observations; the last entry also counts all longer
            tracks.
        angle_limits: limits of the angle classes in degrees, ascending.
        angles: (len(angle_limits) + 1,) points by the largest angle between two of their rays:
            below the first limit, between consecutive limits, and above the last one. Only points
            with at least two observations count.
    """

    lengths: NDArray[np.int64]
    angle_limits: tuple[float, ...]
    angles: NDArray[np.int64]


def track_statistics(problem: Problem) -> TrackStatistics:
    """Return the statistics of all points.

    The angle of two rays is at most 90 degrees, as in ``bundle.filter_observations``.
    """
    length = np.bincount(problem.observation_point, minlength=problem.num_points)
    longest = min(int(length.max(initial=0)), LONGEST)
    order = np.argsort(problem.observation_point, kind="stable")
    reached = [int(enclose_angle(problem, order, limit).sum()) for limit in ANGLES]
    twice = int((length >= 2).sum())
    return TrackStatistics(
        lengths=np.bincount(np.minimum(length, longest), minlength=longest + 1),
        angle_limits=ANGLES,
        angles=np.array([twice, *reached]) - np.array([*reached, 0]),
    )


def length_figure(tracks: TrackStatistics, longest: int | None = None) -> Figure:
    """Return the number of points against the number of their observations.

    Args:
        tracks: the distributions.
        longest: length of the longest track; None: the last class may contain longer ones.
    """
    last = len(tracks.lengths) - 1
    names = [f"{length}" for length in range(last + 1)]
    names[-1] += " or more" if longest is None or longest > last else ""
    title = "Points by observations, log scale"
    return _bars("track_lengths", title, names, tracks.lengths)


def angle_figure(tracks: TrackStatistics) -> Figure:
    """Return the number of points against the largest angle between two of their rays."""
    limits = tracks.angle_limits
    names = [f"below {limits[0]:g}°"]
    names += [f"{low:g} to {high:g}°" for low, high in pairwise(limits)]
    names.append(f"{limits[-1]:g} to 90°")
    title = "Points by angle of rays, log scale"
    return _bars("triangulation_angles", title, names, tracks.angles)


def _bars(name: str, title: str, names: list[str], counts: NDArray[np.int64]) -> Figure:
    values = dict(zip(names, map(float, counts.tolist()), strict=True))
    return Figure(name=name, title=title, marks=(Bars(values, amount, is_ordered=True),))
