"""Refinement that also completes, merges and triangulates tracks, with the matches of a database.

This is what COLMAP's mapper does at its end (``IncrementalMapper::IterativeGlobalRefinement``), for
any model of the images of a database. Round 1 adjusts the model with the tracks that it has: the
triangulator needs good poses. Its loss is ``FIRST_LOSS`` unless another loss is asked for, because
a wrong track among few observations can bend a model. Every other round

1. extends the tracks with COLMAP's triangulator (:mod:`bundle.model.pycolmap.tracks`);
2. adjusts all, as :func:`bundle.solve` does, with the same priors, factors and rules;
3. filters observations and points, as :func:`bundle.filter_observations` does.

The run ends with the first round that changes less than ``SMALLEST_CHANGE`` of its observations.
The problem is moved to its priors, and rules are resolved, before the first round only.

Held-out observations are drawn from the input, and all of this is repeated without them: neither
the adjustment nor the triangulator sees their keypoints, nor other keypoints at the same place, nor
their matches. After each round, their errors are computed at the points to which most other
observations of their tracks belong. A point that the rounds deleted is triangulated from these
other observations, with the cameras of the round. All rounds are thus judged by the same
observations; the first is a solve of the input.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Iterable
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
from bundle.model.residuals import HeldOut, errors_or_nan, summarize_clipped
from bundle.model.rolling_shutter import refuse
from bundle.solving.executors import finished
from bundle.solving.hold_out import choose, triangulated
from bundle.solving.prepare import Prepared, prepare, rule_ends
from bundle.solving.request import Bounds, SolveRequest
from bundle.solving.result import Result
from bundle.solving.rounds.plan import RunPlan, State
from bundle.solving.rounds.solve_rounds import run_rounds

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
    """Adjust a problem several times, and complete, merge and triangulate its tracks in between.

    COLMAP's triangulator (pycolmap) extends the tracks with the verified matches of a database;
    the adjustments are those of :func:`bundle.solve`. Each round but the first extends the tracks,
    adjusts, and filters as :func:`bundle.filter_observations` does. The first round adjusts the
    problem as it is, with the loss "soft_l1" instead of "trivial". The run ends early if a round
    changes less than 0.05 % of its observations. After the last filter the problem is adjusted once
    more.

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
        constraints: rules of all but points, as in :func:`bundle.solve`, at the first start.
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
        is_share_given: True to raise an error if the held-out share cannot be drawn.
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
    tracks = _Tracks(request, plan.rounds, matches, tell)
    result = tracks.run(given, progress)
    if held is None or not result.summary.is_solution_usable or result.summary.interrupted:
        return result
    try:
        return _with_held_out(result, request, plan, matches, held, tell)
    except KeyboardInterrupt:
        return result


def _check(request: SolveRequest, plan: RunPlan) -> None:
    """Refuse options that a run with changing tracks does not support."""
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


class _Tracks:
    """Rounds that extend tracks, adjust and filter.

    ``each``: function of the problem after the filter of each round. ``are_counted``: True if a
    round with few changes ends the run.
    """

    def __init__(
        self,
        request: SolveRequest,
        limits: RoundOptions,
        matches: DatabaseMatches,
        tell: Callable[[str], None],
        each: Callable[[Problem], None] = lambda _: None,
        *,
        are_counted: bool = True,
    ) -> None:
        options = request.options
        first = options.replace(loss=FIRST_LOSS) if options.loss == "trivial" else options
        self._first = prepare(request.at(request.problem, options=first))  # placed, with rules
        applied = self._first.applied
        ruled = applied and (*applied.fixed_point_ids, *touched_ids(applied.factors)["point"])
        if ruled:
            raise InputError(
                "constraints: expected no rules of points with database, which may merge them, "
                f"found point {ruled[0]}"
            )
        self._request, self._limits, self._matches = request, limits, matches
        self._tell, self._each, self._are_counted = tell, each, are_counted
        self._counts = (0, 0, 0)
        self._rounds: tuple[TrackRound, ...] = ()
        self._prepared = self._first
        self._whole: tuple[Prepared, Result, State] | None = None  # the last whole round
        self._builder: TrackBuilder | None = None

    def extended(
        self, prepared: Prepared, result: Result, state: State, is_last: bool
    ) -> tuple[Prepared, State]:
        """Record a round, and extend the tracks for the next one; see ``Between``."""
        placed, done = prepared.placed, state.rounds[-1]
        left = placed.taken_from(state.problem)
        track = TrackRound(
            round=done.round,
            triangulated=self._counts[0],
            completed=self._counts[1],
            merged=self._counts[2],
            deleted=done.num_observations_removed,
            num_observations=left.num_observations,
            num_points=left.num_points,
        )
        self._rounds, self._whole = (*self._rounds, track), (prepared, result, state)
        self._each(left)
        if is_last:
            if state.end is None:
                self._tell("adjusting what is left")
            return prepared, state
        from bundle.model.pycolmap.tracks import TrackBuilder

        self._tell(f"round {done.round + 1}: extending tracks")
        if self._builder is None:
            limits = self._limits.max_error, self._limits.min_angle
            self._builder = TrackBuilder(left, *self._matches, *limits)
        else:
            adjusted = placed.taken_from(result.problem)
            self._builder.take(adjusted, state.observation_mask[: adjusted.num_observations])
        problem, self._counts = self._builder.extend()
        rules = self._first.applied or ()
        self._prepared = prepare(self._request.at(problem, align=False, constraints=rules))
        changed = sum(self._counts) if self._are_counted else math.inf
        return self._prepared, self._start(state.rounds, changed)

    def _start(self, rounds: tuple[Round, ...] = (), num_extended: float = math.inf) -> State:
        """Return the state before the adjustment of a round."""
        self._tell(f"round {len(rounds) + 1} of at most {self._limits.num_rounds}: adjusting")
        start = State.first(self._prepared.start)
        return dataclasses.replace(start, rounds=rounds, num_extended=num_extended)

    def run(self, given: Problem, progress: Progress | None = None) -> Result:
        """Return the result for the given problem; after Ctrl-C that of the last whole round."""
        try:
            last, _ = run_rounds(
                self._first, self._start(), self._limits, None, progress, self.extended
            )
            if last.summary.interrupted and self._whole is not None:
                raise KeyboardInterrupt
        except KeyboardInterrupt:
            if self._whole is None:
                raise
            self._prepared, last, state = self._whole
            summary = dataclasses.replace(last.summary, interrupted=True)
            last = dataclasses.replace(
                last, problem=state.problem, summary=summary, rounds=state.rounds
            )
        end = finished(self._prepared, last)
        rows = rows_among(_codes(self._request.problem), _codes(end.problem))
        problem = end.problem if self._builder is None else self._builder.colored(end.problem)
        return dataclasses.replace(
            end,
            problem=problem,
            initial_problem=given,
            similarity=self._first.placed.similarity,
            edits=self._first.edits(),
            constraints=rule_ends(self._first.applied, self._first.placed.problem, end.problem),
            tracks=self._rounds,
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

    def errors(model: Problem) -> NDArray[np.float64]:
        predicted = _predicted(problem, held, model, options)
        return errors_or_nan(predicted, options.cheirality, options.num_threads)[held]

    scores: list[float] = []
    second = _Tracks(
        kept,
        limits,
        _without(matches, problem, held),
        lambda stage: tell(f"without held-out observations: {stage}"),
        lambda model: scores.append(summarize_clipped(errors(model)).clipped_rmse),
        are_counted=False,
    )
    last = second.run(problem)
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
    """Return the matches without held-out keypoints and their duplicates at the same pixels."""
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

    The point of a track is that point of the model to which most of its fitted observations belong.
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
