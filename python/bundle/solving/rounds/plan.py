"""Plan of a run of rounds, the filter of a round, and the state after it.

The filter removes outlier observations and badly determined points by the rules of COLMAP's
``ObservationManager::FilterAllPoints3D``. Observations are removed first, so that an outlier cannot
make a point look well triangulated:

1. Remove an observation if its reprojection error exceeds ``max_error`` pixels, if the point is
   behind the camera, or if the point has no projection. Errors may be standardized.
2. Remove a point and its remaining track if fewer than ``min_track_length`` observations remain.
3. Remove a point if the largest angle between two of its remaining rays is below ``min_angle``
   degrees. An angle above 90 degrees counts as its supplement.

Standardized errors (``model/residuals.py``) have the size of the noise wherever they are. As
outliers bend the model, which makes the errors of its most important observations large, a round
removes only the largest error of each point, and none below 6 times the noise of all errors.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import as_integers
from bundle.base.display import Display, Displayed
from bundle.base.paths import as_path
from bundle.base.records import dataclass
from bundle.base.words import contents, plural
from bundle.errors import InputError
from bundle.interface.judging_options import HoldOutOptions
from bundle.interface.option_fields import number
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import CHECKPOINT_INTERVAL, Round, RoundOptions
from bundle.io.files import Source, as_problem
from bundle.model.problem import Problem
from bundle.model.residuals import RAYLEIGH_MEDIAN, reprojection_errors, standardized_errors
from bundle.solving.layout import Layout, lay_out

if TYPE_CHECKING:
    from bundle.solving.result import Result

BEYOND = 6.0  # size of an outlier, by the noise

_Mask = NDArray[np.bool_]
_Floats = NDArray[np.float64]


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
    standardized: bool = RoundOptions.standardized,
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
        standardized: True to compare standardized errors, of a solve with the default options; raw
            ones if observations leave unknowns undetermined.
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
        max_error=max_error,
        min_angle=min_angle,
        min_track_length=min_track_length,
        standardized=standardized,
    )
    return filter_adjusted(
        problem,
        limits,
        lambda: lay_out(problem, SolveOptions(num_threads=num_threads), ()),
        kept_point_ids,
        kept_track_ids,
        num_threads,
    )


def filter_adjusted(
    problem: Problem,
    limits: RoundOptions,
    layout: Callable[[], Layout],
    kept_point_ids: Iterable[int] = (),
    kept_track_ids: Iterable[int] = (),
    num_threads: int = 0,
) -> Filtered:
    """Filter a problem that a solve with this layout has adjusted."""
    tracks = _mask_of("kept_track_ids", problem, kept_track_ids)
    always = tracks | _mask_of("kept_point_ids", problem, kept_point_ids)
    errors, behind = reprojection_errors(problem, num_threads=num_threads)
    if limits.standardized:
        used = layout()
        given = used.options.asdict(), used.limits, used.core_factors()
        with suppress(InputError):  # without full rank, no redundancy is known
            errors = _of_suspects(problem, errors, standardized_errors(problem, errors, given))
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
        from bundle.model.ray_angles import enclose_angle  # a run without rounds needs none

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


def _of_suspects(problem: Problem, errors: _Floats, tested: _Floats) -> _Floats:
    """Return the largest tested error of each point, if it exceeds the noise; 0 for all others.

    Undefined errors stay NaN.
    """
    largest = np.zeros(problem.num_points)
    np.fmax.at(largest, problem.observation_point, tested)
    noise = float(np.nanmedian(tested)) / RAYLEIGH_MEDIAN
    is_far = (tested >= largest[problem.observation_point]) & (tested > BEYOND * noise)
    return np.where(is_far | np.isnan(errors), tested, 0.0)


def _mask_of(name: str, problem: Problem, point_ids: Iterable[int]) -> _Mask:
    ids = as_integers(name, point_ids)
    found = np.isin(ids, problem.point_ids)
    if not found.all():
        raise InputError(f"{name}: there is no point {ids[~found].flat[0]} in the problem")
    return np.isin(problem.point_ids, ids) if ids.size else np.zeros(problem.num_points, bool)


# Run of rounds: its plan, and its state after each filter.


@dataclass(frozen=True, init=False)
class RunPlan:
    """Rounds of a run, its checkpoints, and its held-out observations."""

    # number of rounds of adjusting and filtering, and the limits of the filter
    rounds: RoundOptions
    # file that is written after each round and each ``checkpoint_interval`` iterations; None: the
    # file of ``resume``, if given
    checkpoint: Path | None
    resume: Path | None  # checkpoint from which the run continues, if the file exists
    checkpoint_interval: int  # iterations from one checkpoint to the next
    # share of the observations that a second fit holds out; no checkpoint has this fit
    held_out: HoldOutOptions

    def __init__(
        self,
        *,
        rounds: RoundOptions | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        resume: str | os.PathLike[str] | None = None,
        checkpoint_interval: int = CHECKPOINT_INTERVAL,
        held_out: HoldOutOptions | None = None,
    ) -> None:
        interval = number("checkpoint_interval", checkpoint_interval, whole=True, minimum=1)
        vars(self).update(  # frozen
            rounds=RoundOptions() if rounds is None else rounds,
            checkpoint=None if checkpoint is None else as_path(checkpoint, "checkpoint"),
            resume=None if resume is None else as_path(resume, "resume"),
            checkpoint_interval=interval,
            held_out=HoldOutOptions() if held_out is None else held_out,
        )

    @property
    def filters(self) -> bool:
        """True if adjustments and filters take turns; otherwise there is one adjustment."""
        return self.rounds.num_rounds > 0

    @property
    def database(self) -> Path | None:
        """Database of verified matches with which the rounds extend tracks; None: they do not."""
        return None if self.rounds.database is None else Path(self.rounds.database)

    def decisive(self) -> dict[str, Any]:
        """Return the options of the plan that affect the result."""
        return {**self.rounds.asdict(), "checkpoint_interval": self.checkpoint_interval}

    @property
    def file(self) -> Path | None:
        """Path of the checkpoint to write; None: write no checkpoint."""
        return self.resume if self.checkpoint is None else self.checkpoint


@dataclass(frozen=True, eq=False, kw_only=True)
class State:
    """State of a run of rounds."""

    problem: Problem  # start of the next solve, or the end of the run
    observation_mask: _Mask  # mask of the remaining observations of the first round's problem
    point_mask: _Mask  # mask of the remaining points of the first round's problem
    rounds: tuple[Round, ...] = ()  # completed rounds
    # observations that extended the tracks of the problem before its solve, for the rule that ends
    # the rounds; infinite: another round follows in any case
    num_extended: float = 0
    so_far: Result | None = None  # result of the current adjustment so far; None at its start
    end: Result | None = None  # result of the last adjustment of a complete run; None before

    def record(self) -> dict[str, Any]:
        """Return the completed rounds, and whether the run has ended, as JSON values."""
        done = [dataclasses.asdict(one) for one in self.rounds]
        return {"rounds": done, "has_ended": self.end is not None}

    @staticmethod
    def of_record(
        record: dict[str, Any], problem: Problem, masks: list[_Mask], done: Result | None
    ) -> State:
        """Return the state of a record.

        ``record``: record of :meth:`record`. ``masks``: masks of the observations and of the points
        that remain.
        """
        return State(
            problem=problem,
            observation_mask=masks[0],
            point_mask=masks[1],
            rounds=tuple(Round(**one) for one in record["rounds"]),
            so_far=None if record["has_ended"] else done,
            end=done if record["has_ended"] else None,
        )

    @staticmethod
    def first(problem: Problem) -> State:
        """Return the state at the start; its masks take no memory."""
        return State(
            problem=problem,
            observation_mask=np.broadcast_to(True, problem.num_observations),
            point_mask=np.broadcast_to(True, problem.num_points),
        )

    def left(self, filtered: Filtered, done: Round) -> State:
        """Return the state after the filter of a round."""
        return dataclasses.replace(
            self,
            problem=filtered.problem,
            observation_mask=_left_of(self.observation_mask, filtered.observation_mask),
            point_mask=_left_of(self.point_mask, filtered.point_mask),
            rounds=(*self.rounds, done),
        )

    def ended(self, result: Result) -> State:
        """Return the state at the end of the run."""
        return dataclasses.replace(self, end=result)


def _left_of(mask: _Mask, left: _Mask) -> _Mask:
    """Return a mask without those of its True entries that are False in `left`."""
    out = mask.copy()
    out[mask] = left
    return out
