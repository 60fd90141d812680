"""Refinement that also completes, merges and triangulates tracks, with the matches of a database.

This is what COLMAP's mapper does at its end (``IncrementalMapper::IterativeGlobalRefinement``), for
any model of the images of a database. Round 1 adjusts the model with the tracks that it has: the
triangulator needs good poses. Its loss is ``FIRST_LOSS`` unless another loss is asked for, because
a wrong track among few observations can bend a model. Every other round

1. extends the tracks with COLMAP's triangulator (:mod:`bundle.model.pycolmap.tracks`);
2. adjusts all, as :func:`bundle.solve` does, with the same priors, factors and rules;
3. filters observations and points, as :func:`bundle.filter_observations` does.

The rounds end when one changes less than ``SMALLEST_CHANGE`` of its observations. The problem is
moved to its priors, and rules are resolved, before the first round only.

Held-out observations are drawn from the input, and all of this is repeated without them: neither
the adjustment nor the triangulator sees their keypoints, nor other keypoints at the same place, nor
their matches. After each round, their errors are computed at the points to which most other
observations of their tracks belong. A point that the rounds deleted is triangulated from these
other observations, with the cameras of the round. All rounds are thus judged by the same
observations; the first is a solve of the input.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import freeze, rows_among
from bundle.base.optional_packages import require_pycolmap
from bundle.base.paths import as_path
from bundle.errors import InputError, shown
from bundle.interface.judging_options import HoldOutOptions
from bundle.interface.option_class import takes_options
from bundle.interface.option_fields import number
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import (
    DEFAULT_SHARE,
    NUM_TRACK_ROUNDS,
    Round,
    RoundOptions,
    TrackRound,
)
from bundle.interface.solve_record import Progress
from bundle.io.database_images import DatabaseMatches, database_matches
from bundle.io.files import Source, as_problem
from bundle.model.estimates import estimates, with_estimates
from bundle.model.problem_keys import touched_ids
from bundle.model.reprojection import HeldOut, errors_or_nan, summarize_clipped
from bundle.model.rolling_shutter import refuse
from bundle.solving.executors import finished, solve_prepared
from bundle.solving.hold_out import choose, triangulated
from bundle.solving.prepare import Prepared, prepare
from bundle.solving.request import Bounds, SolveRequest
from bundle.solving.result import Result
from bundle.solving.rounds.plan import Filtered, RunPlan, filter_observations
from bundle.solving.rounds.solve_rounds import SMALLEST_CHANGE, check_left, round_of

if TYPE_CHECKING:
    from typing import Unpack

    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.interface.option_keywords import SolveKeywords
    from bundle.model.problem import Problem
    from bundle.model.pycolmap.tracks import TrackBuilder
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule

FIRST_LOSS = "soft_l1"
"""Loss of the first round after "trivial", as of the local adjustments of COLMAP's mapper."""

_Mask = NDArray[np.bool_]


@takes_options(SolveOptions)
def refine_tracks(
    problem: Source,
    database: str | os.PathLike[str],
    options: SolveOptions | None = None,
    *,
    num_rounds: int = NUM_TRACK_ROUNDS,
    max_error: float = RoundOptions.max_error,
    min_angle: float = RoundOptions.min_angle,
    min_track_length: int = RoundOptions.min_track_length,
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    align: bool | None = None,
    bounds: Bounds | None = None,
    constraints: Constraints | Iterable[str | Rule] = (),
    hold_out: float | None = None,
    hold_out_seed: int = 0,
    progress: Progress | None = None,
    **changes: Unpack[SolveKeywords],
) -> Result:
    """Adjust a problem, and complete, merge and triangulate its tracks between the adjustments.

    COLMAP's triangulator (pycolmap) extends the tracks with the verified matches of a database;
    the adjustments are those of :func:`bundle.solve`. Each round but the first extends the tracks,
    adjusts, and filters as :func:`bundle.filter_observations` does. The first round adjusts the
    problem as it is, by the loss "soft_l1" in place of "trivial". The rounds end before
    ``num_rounds`` if one changes less than 0.05 % of its observations. After the last filter the
    problem is adjusted once more.

    Images, cameras, rigs and their ids stay. Points keep their id unless they are merged.

    Args:
        problem: the problem, which is not changed; also the path of one, or a
            pycolmap.Reconstruction. Each observation is a keypoint of the database, up to
            0.05 pixels.
        database: path of a COLMAP database with all images of the problem, by name, their
            keypoints, and matches verified by two-view geometries. It is only read.
        options: options of the adjustments, as in :func:`bundle.solve`.
        num_rounds: maximum number of rounds, at least 2.
        max_error: as in :func:`bundle.filter_observations`, in pixels.
        min_angle: as in :func:`bundle.filter_observations`, in degrees.
        min_track_length: as in :func:`bundle.filter_observations`, at least 2.
        factors: factors in addition to the observations, as in :func:`bundle.solve`, but not of
            points, which may be merged.
        priors: measured positions of images and control points, as in :func:`bundle.solve`.
        align: as in :func:`bundle.solve`, before the first round.
        bounds: bounds of camera parameters, as in :func:`bundle.solve`.
        constraints: rules, as in :func:`bundle.solve`, about the start of the first round.
        hold_out: share of the observations in percent that a second run does not see; 0: no second
            run; None: 10, if the problem has tracks of three images. ``held_out`` of the result
            has its errors at the end, ``tracks`` those of each round.
        hold_out_seed: as in :func:`bundle.hold_out`.
        progress: as in :func:`bundle.solve`, in each round.
        **changes: options by name, which replace those in ``options``.

    Returns:
        Result with the problem after the last adjustment, and the given problem. ``tracks`` has
        the changes of each round, ``rounds`` its adjustment and filter; summary, iterations and
        times belong to the last adjustment. After Ctrl-C, the result of the last whole round.

    Raises:
        InputError: for the reasons of :func:`bundle.solve`; the file is not a database, lacks
            images or has other keypoints; the problem has constant points, rolling shutters or
            sigmas of observations; or pycolmap is not installed.
        KeyboardInterrupt, MemoryError: for the reasons of :func:`bundle.solve`.
        OSError: a file cannot be read.

    Example:
        >>> result = bundle.refine_tracks("sparse/0", "database.db")
        >>> bundle.save(result.problem, "refined")
    """
    options = SolveOptions.of(options, changes, "refine_tracks")
    limits = RoundOptions(
        num_rounds=num_rounds,
        max_error=max_error,
        min_angle=min_angle,
        min_track_length=min_track_length,
        database=str(as_path(database, "database")),
    )
    held_out = HoldOutOptions(
        hold_out=DEFAULT_SHARE if hold_out is None else hold_out, hold_out_seed=hold_out_seed
    )
    request = SolveRequest(
        problem=as_problem(problem),
        options=options,
        factors=factors,
        priors=priors,
        align=align,
        bounds=bounds,
        constraints=constraints,
    )
    plan = RunPlan(rounds=limits, held_out=held_out)
    return run(request, plan, progress, is_share_given=hold_out is not None)


def run(
    request: SolveRequest,
    plan: RunPlan,
    progress: Progress | None = None,
    *,
    is_share_given: bool = True,
    tell: Callable[[str], None] = lambda _: None,
) -> Result:
    """Refine a problem and its tracks; see :func:`refine_tracks`.

    Args:
        is_share_given: True if a held-out share that cannot be drawn is an error.
    """
    given = request.problem
    _check(request, plan)
    require_pycolmap("refine_tracks")
    from bundle.model.pycolmap.tracks import on_keypoints  # imports pycolmap

    path = plan.database
    assert path is not None
    tell(f"reading {shown(path)}")
    matches = database_matches(path, given.image_names)
    request = request.at(on_keypoints(given, matches.keypoints, shown(path)))
    held = _held_out(request.problem, plan.held_out, is_share_given)
    rounds = _Rounds(request, plan.rounds, matches, progress, tell)
    for _ in rounds:
        pass
    result = rounds.result(given)
    if held is None or not result.summary.is_solution_usable or result.summary.interrupted:
        return result
    try:
        return _with_held_out(result, request, plan, matches, held, tell)
    except KeyboardInterrupt:
        return result


def _check(request: SolveRequest, plan: RunPlan) -> None:
    """Refuse what a run that changes tracks cannot serve.

    Raises:
        InputError: the message names the option.
    """
    problem, limits = request.problem, plan.rounds
    number("num_rounds", limits.num_rounds, minimum=2)
    number("min_track_length", limits.min_track_length, minimum=2)
    refuse(problem, problem.rolling_shutter, "database")
    if plan.file is not None:
        name = "resume" if plan.checkpoint is None else "checkpoint"
        raise InputError(
            f"{name}: not valid with a database of tracks; to continue, refine the output again"
        )
    if request.part is not None:
        raise InputError(
            "only_images: not valid with a database, which extends tracks of all images"
        )
    if problem.observation_sigma is not None:
        raise InputError("database: expected observations without sigmas, found sigmas")
    if "points" not in request.options.refine:
        raise InputError("refine: expected points with a database, which triangulates new ones")
    named = sorted(touched_ids(request.factors)["point"])
    if request.options.fixed_point_ids or named:
        ids = (*request.options.fixed_point_ids, *named)
        raise InputError(
            f"database: expected no constant points or factors of points, which may be merged, "
            f"found point {ids[0]}"
        )


class _Rounds:
    """Rounds of extending tracks, adjusting and filtering; iterate over them, then take the result.

    Each step of the iteration is a whole round and yields the problem after its filter.
    """

    def __init__(
        self,
        request: SolveRequest,
        limits: RoundOptions,
        matches: DatabaseMatches,
        progress: Progress | None,
        tell: Callable[[str], None],
        *,
        are_counted: bool = True,
    ) -> None:
        options = request.options
        first = options.replace(loss=FIRST_LOSS) if options.loss == "trivial" else options
        self._first = prepare(request.at(request.problem, options=first))  # placed, with rules
        applied = self._first.applied
        if applied is not None and applied.fixed_point_ids:
            raise InputError(
                "constraints: expected no constant points with database, which may merge them, "
                f"found point {applied.fixed_point_ids[0]}"
            )
        self._request, self._limits, self._matches = request, limits, matches
        self._progress, self._tell, self._are_counted = progress, tell, are_counted
        self._tracks: tuple[TrackRound, ...] = ()
        self._rounds: tuple[Round, ...] = ()
        self._start: Result | None = None  # of the first round
        self._last: Result | None = None  # of the last whole round
        self._left: Filtered | None = None  # after its filter
        self._end: Result | None = None
        self._builder: TrackBuilder | None = None

    def __iter__(self) -> Iterator[Problem]:
        try:
            yield from self._whole_rounds()
        except KeyboardInterrupt:
            if self._last is None:
                raise
            self._end = self._interrupted()

    @property
    def tracks(self) -> tuple[TrackRound, ...]:
        """Changes of each whole round."""
        return self._tracks

    def _whole_rounds(self) -> Iterator[Problem]:
        from bundle.model.pycolmap.tracks import TrackBuilder

        problem, counts = self._request.problem, (0, 0, 0)
        for count in range(1, self._limits.num_rounds + 1):
            self._tell(f"round {count} of at most {self._limits.num_rounds}: adjusting")
            result = self._adjusted(self._first if count == 1 else self._prepared(problem))
            if not result.summary.is_solution_usable or result.summary.interrupted:
                if self._last is not None and result.summary.interrupted:
                    raise KeyboardInterrupt
                self._start, self._end = self._start or result, result
                return
            left = self._filtered(count, result, counts)
            yield left.problem
            change = sum(counts) + left.num_observations_removed
            is_still = count > 1 and change < SMALLEST_CHANGE * result.problem.num_observations
            if count == self._limits.num_rounds or (is_still and self._are_counted):
                break
            self._tell(f"round {count + 1}: extending tracks")
            if self._builder is None:
                limits = self._limits.max_error, self._limits.min_angle
                self._builder = TrackBuilder(left.problem, *self._matches, *limits)
            else:
                self._builder.take(result.problem, left.observation_mask)
            problem, counts = self._builder.extend()
        self._end = self._last
        if self._left is not None and self._left.num_observations_removed:
            self._tell("adjusting what is left")
            self._end = self._adjusted(self._prepared(self._left.problem))
            if self._end.summary.interrupted:
                raise KeyboardInterrupt

    def _prepared(self, problem: Problem) -> Prepared:
        """Return the solve of a later round: priors and rules as in the first."""
        request, applied = self._request, self._first.applied
        rules = () if applied is None else applied
        return prepare(request.at(problem, align=False, constraints=rules))

    def _adjusted(self, prepared: Prepared) -> Result:
        return finished(prepared, solve_prepared(prepared, self._progress))

    def _filtered(self, count: int, result: Result, counts: Sequence[int]) -> Filtered:
        """Filter an adjusted problem, and add the records of the round."""
        limits = self._limits
        left = filter_observations(
            result.problem,
            limits.max_error,
            limits.min_angle,
            limits.min_track_length,
            num_threads=self._request.options.num_threads,
        )
        done = round_of(count, result, left, limits)
        check_left(left, done, limits)
        track = TrackRound(
            round=count,
            triangulated=counts[0],
            completed=counts[1],
            merged=counts[2],
            deleted=left.num_observations_removed,
            num_observations=left.problem.num_observations,
            num_points=left.problem.num_points,
        )
        self._rounds, self._tracks = (*self._rounds, done), (*self._tracks, track)
        self._start, self._last, self._left = self._start or result, result, left
        return left

    def _interrupted(self) -> Result:
        """Return the last whole round."""
        last, left = self._last, self._left
        assert last is not None and left is not None
        summary = dataclasses.replace(last.summary, interrupted=True)
        return dataclasses.replace(last, problem=left.problem, summary=summary)

    def result(self, given: Problem) -> Result:
        """Return the result for the given problem, after the iteration."""
        first, end = self._start, self._end
        assert first is not None and end is not None
        applied, ends = self._first.applied, end.constraints
        if applied is not None:
            from bundle.solving.constraints.ends import rule_ends  # few runs have rules

            ends = rule_ends(applied, self._first.placed.problem, end.problem)
        rows = rows_among(_codes(self._request.problem), _codes(end.problem))
        problem = end.problem if self._builder is None else self._builder.colored(end.problem)
        return dataclasses.replace(
            end,
            problem=problem,
            initial_problem=given,
            similarity=first.similarity,
            edits=first.edits,
            constraints=ends,
            rounds=self._rounds,
            tracks=self._tracks,
            observation_mask=rows >= 0,
            observation_rows=rows[rows >= 0],
        )


def _codes(problem: Problem) -> NDArray[np.int64]:
    """Return one number for the image and keypoint of each observation."""
    keypoint = problem.observation_keypoint
    assert keypoint is not None
    return (problem.observation_image.astype(np.int64) << 32) + keypoint


def _held_out(problem: Problem, options: HoldOutOptions, is_given: bool) -> _Mask | None:
    """Return a mask of the observations to hold out; None: hold out none."""
    if not options.hold_out:
        return None
    try:
        return choose(problem, options.hold_out, options.hold_out_seed, name="hold_out")
    except InputError:
        if is_given:
            raise
        return None


def _with_held_out(
    result: Result,
    request: SolveRequest,
    plan: RunPlan,
    matches: DatabaseMatches,
    held: _Mask,
    tell: Callable[[str], None],
) -> Result:
    """Return the result with the errors of a second run at the observations held out from it.

    The second run has as many rounds as the first.
    """
    problem, options = request.problem, request.options
    kept = request.at(problem.select(observations=~held).problem)
    limits = dataclasses.replace(plan.rounds, num_rounds=len(result.tracks))
    second = _Rounds(
        kept, limits, _without(matches, problem, held), None,
        lambda stage: tell(f"without held-out observations: {stage}"), are_counted=False,
    )  # fmt: skip

    def errors(model: Problem) -> NDArray[np.float64]:
        predicted = _predicted(problem, held, model, options)
        return errors_or_nan(predicted, options.cheirality, options.num_threads)[held]

    scores = [summarize_clipped(errors(model)).clipped_rmse for model in second]
    last = second.result(problem)
    if last.summary.interrupted or not last.summary.is_solution_usable:
        return result
    fitted = errors_or_nan(last.problem, options.cheirality, options.num_threads)
    record = HeldOut(
        **vars(summarize_clipped(errors(last.problem))),
        percent=plan.held_out.hold_out,
        seed=plan.held_out.hold_out_seed,
        fitted=summarize_clipped(fitted),
        is_converged=last.summary.termination_type == "CONVERGENCE",
    )
    tracks = tuple(
        dataclasses.replace(one, held_out_rmse=score)
        for one, score in zip(result.tracks, scores, strict=True)
    )
    return dataclasses.replace(result, held_out=record, tracks=tracks)


def _without(matches: DatabaseMatches, problem: Problem, held: _Mask) -> DatabaseMatches:
    """Return the matches without held-out keypoints and others at the same pixel."""
    codes = _codes(problem)[held]
    gone = []
    for row, xy in enumerate(matches.keypoints):
        place = xy[:, 0] + 1j * xy[:, 1]
        gone.append(np.isin(place, place[codes[codes >> 32 == row] & 0xFFFFFFFF]))
    pairs = [
        (a, b, found[~(gone[a][found[:, 0]] | gone[b][found[:, 1]])])
        for a, b, found in matches.pairs
    ]
    return DatabaseMatches(matches.keypoints, pairs)


def _predicted(problem: Problem, held: _Mask, model: Problem, options: SolveOptions) -> Problem:
    """Return the problem with the cameras of a model of other tracks, and its points.

    A track gets the point of the model to which most of its fitted observations belong.
    """
    rows = rows_among(_codes(problem)[~held], _codes(model))
    both = np.stack([problem.observation_point[~held], model.observation_point[rows]], axis=1)
    pairs, counts = np.unique(both[rows >= 0], axis=0, return_counts=True)
    order = np.lexsort((counts, pairs[:, 0]))  # the most frequent of each track comes last
    points, is_lost = problem.points.copy(), np.zeros(problem.num_points, bool)
    is_lost[problem.observation_point[held]] = True
    points[pairs[order, 0]] = model.points[pairs[order, 1]]
    is_lost[pairs[:, 0]] = False
    predicted = with_estimates(problem, estimates(model) | {"points": freeze(points)})
    return triangulated(predicted, is_lost, held, options)
