"""Removal of outlier observations and badly determined points, by COLMAP's rules.

The rules are those of ``ObservationManager::FilterAllPoints3D``. Observations are removed first,
so that an outlier cannot make a point look well triangulated:

1. Remove an observation if its reprojection error exceeds ``max_error`` pixels, if the point is
   behind the camera, or if the point has no projection.
2. Remove a point and its remaining track if fewer than ``min_track_length`` observations remain.
3. Remove a point if the largest angle between two of its remaining rays is below ``min_angle``
   degrees. An angle above 90 degrees counts as its supplement.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import as_integers
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import contents, plural
from bundle.errors import InputError
from bundle.interface.round_options import RoundOptions
from bundle.io.files import Source, as_problem
from bundle.model.problem import Problem
from bundle.model.ray_angles import enclose_angle
from bundle.model.reprojection import reprojection_errors

_Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Filtered(Displayed):
    """Filtered problem, and masks and counts of the removed observations and points.

    Attributes:
        problem: the remaining problem; the given problem object if nothing was removed.
        observation_mask: (num_observations,) True for observations of the given problem that stay.
        point_mask: (num_points,) True for points of the given problem that stay.
        num_observations_removed: total number, including observations of removed points.
        num_points_removed: total number.
        num_observations_beyond_max_error: observations removed by rule 1, including those behind
            the camera or without a projection.
        num_points_with_short_track: points removed by rule 2.
        num_points_below_min_angle: points removed by rule 3.
        num_observations_with_short_track: observations removed with them by rule 2.
        num_observations_below_min_angle: observations removed with them by rule 3.
    """

    problem: Problem
    observation_mask: _Mask
    point_mask: _Mask
    num_observations_removed: int
    num_points_removed: int
    num_observations_beyond_max_error: int
    num_points_with_short_track: int
    num_points_below_min_angle: int
    num_observations_with_short_track: int
    num_observations_below_min_angle: int

    def _display(self) -> Display:
        return Display(
            title=(
                f"Filtered: {plural(self.num_observations_removed, 'observation')} and "
                f"{plural(self.num_points_removed, 'point')} removed"
            ),
            facts=(
                ("beyond the largest error", str(self.num_observations_beyond_max_error)),
                ("points with a short track", str(self.num_points_with_short_track)),
                ("points below the angle", str(self.num_points_below_min_angle)),
                ("left", contents(self.problem)),
            ),
        )


def filter_observations(
    problem: Source,
    max_error: float = RoundOptions.max_error,
    min_angle: float = RoundOptions.min_angle,
    min_track_length: int = RoundOptions.min_track_length,
    *,
    kept_point_ids: Iterable[int] = (),
    kept_track_ids: Iterable[int] = (),
    num_threads: int = 0,
) -> Filtered:
    """Remove observations with large errors, and points with short tracks or small angles.

    The rules are COLMAP's (``ObservationManager.filter_all_points3D``). Cameras and images stay,
    observed or not. The remaining points keep ids, tracks, keypoints and colours. In a saved COLMAP
    model, the keypoints of removed observations have no point.

    Args:
        problem: the problem, which is not changed; also the path of one, or a
            pycolmap.Reconstruction.
        max_error: largest reprojection error of an observation, in pixels. Observations behind
            their camera or without a projection are always removed.
        min_angle: smallest triangulation angle of a point, in degrees from 0 to 90. The angle of a
            point is the largest one over all pairs of its observations. A point with a single
            observation has no angle and stays only with ``min_angle`` 0.
        min_track_length: smallest number of observations of a point.
        kept_point_ids: ids of points that stay with any track and angle, such as surveyed points;
            ``max_error`` still applies to their observations.
        kept_track_ids: ids of points that stay with all their observations.
        num_threads: number of threads; 0: all cores.

    Raises:
        InputError: a limit is out of range, a point of an id does not exist, or an observed image
            has a camera model that is not supported.
        OSError: the path cannot be read.

    Example:
        >>> filtered = bundle.filter_observations(result.problem, max_error=2.0)
        >>> result = bundle.solve(filtered.problem)
    """
    problem = as_problem(problem)
    limits = RoundOptions(
        max_error=max_error, min_angle=min_angle, min_track_length=min_track_length
    )
    tracks = _mask_of("kept_track_ids", problem, kept_track_ids)
    always = tracks | _mask_of("kept_point_ids", problem, kept_point_ids)
    errors, behind = reprojection_errors(problem, num_threads=num_threads)
    good = (errors <= limits.max_error) & ~behind  # false for nan
    if tracks.any():
        good |= tracks[problem.observation_point]
    return _filtered(problem, good, limits, always)


def _filtered(problem: Problem, good: _Mask, limits: RoundOptions, always: _Mask) -> Filtered:
    left = np.flatnonzero(good)
    point = problem.observation_point
    track = np.bincount(point[left], minlength=problem.num_points)
    short = (track < limits.min_track_length) & ~always
    stays = ~short
    if limits.min_angle > 0:
        stays &= always | enclose_angle(problem, left, limits.min_angle)
    observations = good & stays[point]
    num_observations = int(observations.sum())
    num_points = int(stays.sum())
    return Filtered(
        problem=problem.select(points=stays, observations=observations).problem,
        observation_mask=observations,
        point_mask=stays,
        num_observations_removed=problem.num_observations - num_observations,
        num_points_removed=problem.num_points - num_points,
        num_observations_beyond_max_error=problem.num_observations - len(left),
        num_points_with_short_track=int(short.sum()),
        num_points_below_min_angle=problem.num_points - num_points - int(short.sum()),
        num_observations_with_short_track=int(track[short].sum()),
        num_observations_below_min_angle=int(track[~short & ~stays].sum()),
    )


def _mask_of(name: str, problem: Problem, point_ids: Iterable[int]) -> _Mask:
    ids = as_integers(name, point_ids)
    found = np.isin(ids, problem.point_ids)
    if not found.all():
        raise InputError(f"{name}: there is no point {ids[~found].flat[0]} in the problem")
    return np.isin(problem.point_ids, ids) if ids.size else np.zeros(problem.num_points, bool)
