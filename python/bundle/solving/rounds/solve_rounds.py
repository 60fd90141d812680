"""Rounds of adjusting and filtering (COLMAP's iterative refinement)."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from bundle.errors import InputError
from bundle.interface.judging_options import HoldOutOptions
from bundle.interface.option_class import takes_options
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import CHECKPOINT_INTERVAL, Round, RoundOptions
from bundle.interface.solve_record import Progress
from bundle.io.files import Source, as_problem
from bundle.model.problem_keys import ImageSelection, touched_ids
from bundle.solving.executors import finished, solve_prepared
from bundle.solving.prepare import Prepared, prepare
from bundle.solving.request import Bounds, PartRequest, SolveRequest
from bundle.solving.result import Result
from bundle.solving.rounds.plan import Filtered, RunPlan, State, filter_adjusted

if TYPE_CHECKING:
    from typing import Unpack

    from bundle.georeference.measurements import Prior
    from bundle.graphs.factors.factors import Factor
    from bundle.interface.option_keywords import SolveKeywords
    from bundle.model.problem import Problem
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule
    from bundle.solving.rounds.checkpoint import Checkpoint

SMALLEST_CHANGE = 5e-4
"""Smallest fraction of observations removed in a round for which another round follows, as in
COLMAP (``ba_global_max_refinement_change``)."""


@takes_options(SolveOptions)
def solve_rounds(
    problem: Source,
    options: SolveOptions | None = None,
    *,
    num_rounds: int = 5,
    max_error: float = RoundOptions.max_error,
    min_angle: float = RoundOptions.min_angle,
    min_track_length: int = RoundOptions.min_track_length,
    standardized: bool = RoundOptions.standardized,
    only_images: ImageSelection | None = None,
    rest: str = "fixed",
    factors: Iterable[Factor] = (),
    priors: Iterable[Prior] = (),
    align: bool | None = None,
    bounds: Bounds | None = None,
    constraints: Constraints | Iterable[str | Rule] = (),
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_interval: int = CHECKPOINT_INTERVAL,
    resume: str | os.PathLike[str] | None = None,
    hold_out: float = 0.0,
    hold_out_seed: int = 0,
    progress: Progress | None = None,
    **changes: Unpack[SolveKeywords],
) -> Result:
    """Adjust and filter in turns, so that removed outliers do not disturb the next adjustment.

    Each round is a :func:`bundle.solve` of the remaining problem, followed by a
    :func:`bundle.filter_observations`, also in the last round. The rounds end before ``num_rounds``
    if a round removes less than 0.05 % of its observations (COLMAP's rule). They also end if an
    adjustment has no usable solution or was interrupted; no filter follows this adjustment. The
    filter changes the objective, so that costs of different rounds cannot be compared. After the
    last filter the remaining problem is adjusted once more: the returned problem is at a minimum.

    Points that are constant (``fixed_point_ids``) or that a factor names are not removed for a
    short track or small angle. They can only lose observations.

    Args:
        problem: the problem, which is not changed; also the path of one, or a
            pycolmap.Reconstruction.
        options: options of the adjustments, as in :func:`bundle.solve`.
        num_rounds: maximum number of rounds; 0: adjust once without filtering.
        max_error: as in :func:`bundle.filter_observations`, in pixels.
        min_angle: as in :func:`bundle.filter_observations`, in degrees.
        min_track_length: as in :func:`bundle.filter_observations`, in observations.
        standardized: as in :func:`bundle.filter_observations`, of the solve of each round.
        only_images: refine only these images, the points that they see and their cameras. All else
            is constant and stays equal bit for bit. Ids and names, such as ``"1,5-9,left/*.jpg"``
            or ``[1, 5, "left/*.jpg"]``. Only the points that these images see go to the solver and
            the filter, with all their observations. A camera that also took other images is
            refined, too, unless it is in ``fixed_camera_ids`` (``part`` of the result names it).
        rest: treatment of all else with ``only_images``. "fixed": other images that see one of
            these points (the neighbours) take part and are constant. "marginal": the neighbours and
            their cameras move, under the exact marginal prior of the rest, linearized at its
            present values. Only the named images, their points and cameras change in the result;
            all else stays equal bit for bit. If nothing fixes the gauge, the neighbours stay in
            place on average. The cost includes the cost of the prior; ``part.rest`` of the result
            describes the prior.
        factors: factors in addition to the observations, as in :func:`bundle.solve`. With the
            marginal rest, a factor goes into the prior if it has no refined variable and not only
            neighbours as variables. ``factor_costs_before`` and ``_after`` do not include it.
        priors: measured positions of images and control points, as in :func:`bundle.solve`. No
            filter removes a measurement of a control point; counts of points and observations in
            ``rounds`` include control points.
        align: as in :func:`bundle.solve`, before the first round; never with ``only_images``.
        bounds: bounds of camera parameters, as in :func:`bundle.solve`.
        constraints: rules, as in :func:`bundle.solve`. Rules about the start refer to the start of
            the first round. With ``only_images``, a parameter that is shared with a camera outside
            the part is constant. Rules are not allowed with the marginal rest.
        checkpoint: file that is replaced atomically after each round and each
            ``checkpoint_interval`` iterations, so that a killed run can continue. The solver
            restarts from the content of the file in every run, killed or not. With the option
            ``deterministic``, a resumed run has the same result as an uninterrupted run, bit for
            bit.
        checkpoint_interval: iterations from one checkpoint to the next within a round.
        resume: checkpoint from which the run continues, with the same problem and options (the
            number of threads may differ). If the file does not exist, the run begins at the start.
            Further checkpoints are written to this file unless ``checkpoint`` names another one.
        hold_out: as in :func:`bundle.solve`. The second fit has rounds of its own. Observations
            that it removes keep their errors, and points that it removes are triangulated again
            with its cameras. With ``only_images``, the observations to hold out are those of the
            named images.
        hold_out_seed: as in :func:`bundle.solve`.
        progress: as in :func:`bundle.solve`, in each round.
        **changes: options by name, which replace those in ``options``.

    Returns:
        Result with the problem after the last filter and adjustment, and the given problem.
        ``rounds`` describes each round; summary, iterations and times belong to the last
        adjustment.

    Raises:
        InputError: for the reasons of :func:`bundle.solve` and :func:`bundle.filter_observations`;
            a filter removed all observations; the file is not a checkpoint; or the checkpoint
            belongs to another problem or to other options.
        KeyboardInterrupt, MemoryError: for the reasons of :func:`bundle.solve`.
        OSError: for the reasons of :func:`bundle.solve`, or the checkpoint cannot be read or
            written.
    """
    options = SolveOptions.of(options, changes, "solve_rounds")
    limits = RoundOptions(
        num_rounds=num_rounds,
        max_error=max_error,
        min_angle=min_angle,
        min_track_length=min_track_length,
        standardized=standardized,
    )
    part = PartRequest.of(only_images, rest)
    plan = RunPlan(
        rounds=limits,
        checkpoint=checkpoint,
        resume=resume,
        checkpoint_interval=checkpoint_interval,
        held_out=HoldOutOptions(hold_out=hold_out, hold_out_seed=hold_out_seed),
    )
    request = SolveRequest(
        problem=as_problem(problem),
        options=options,
        factors=factors,
        priors=priors,
        align=align,
        bounds=bounds,
        constraints=constraints,
        part=part,
    )
    return run(request, plan, progress)


def run(request: SolveRequest, plan: RunPlan, progress: Progress | None = None) -> Result:
    """Run a plan: adjust once, or adjust and filter in turns; see :func:`solve_rounds`.

    The filter changes the objective. Therefore the remaining problem is adjusted once more after
    the last filter, unless this filter removed nothing. The run then ends at a minimum.
    """
    prepared = prepare(request)
    held_out = checkpoint = None  # most runs need neither, whose imports would delay them
    if plan.held_out.hold_out:
        from bundle.solving.hold_out import HeldOutFit

        held_out = HeldOutFit(prepared, plan.held_out)
    if plan.file is not None:
        from bundle.solving.rounds.checkpoint import Checkpoint

        checkpoint = Checkpoint.of(plan.file, prepared, plan)
    state = State.first(prepared.start)
    if checkpoint is not None and plan.resume is not None and plan.resume.exists():
        state = checkpoint.read(plan.resume, prepared)

    def fit(prepared: Prepared) -> tuple[Result, State]:
        start = State.first(prepared.start)
        return run_rounds(prepared, start, plan.rounds, None, progress)

    last, state = run_rounds(prepared, state, plan.rounds, checkpoint, progress)
    result = finished(prepared, last, state)
    return result if held_out is None else held_out.measured(result, last, state, fit)


Between = Callable[[Prepared, Result, State, bool], "tuple[Prepared, State]"]
"""Function of a solve, its result, and the state after its filter, that returns the solve and the
state of the next round; the last argument is True if there is none."""


def run_rounds(
    prepared: Prepared,
    state: State,
    limits: RoundOptions,
    checkpoint: Checkpoint | None,
    progress: Progress | None,
    between: Between | None = None,
) -> tuple[Result, State]:
    """Adjust and filter from a state; return the last result for the start, and its state."""
    is_last = limits.num_rounds == 0 or _is_last(state, limits)  # no filter follows the next solve
    while state.end is None:
        result = _adjust(prepared, state, checkpoint, progress)
        if result.summary.interrupted or not result.summary.is_solution_usable:
            # a checkpoint keeps the earlier state
            return dataclasses.replace(result, rounds=state.rounds), state
        state = dataclasses.replace(state, problem=result.problem, so_far=None)
        if is_last:
            state = state.ended(result)
        else:
            state = _filtered(prepared, state, result, limits)
            is_last = _is_last(state, limits)
            if is_last and not state.rounds[-1].num_observations_removed:
                state = state.ended(result)
            if between is not None:
                prepared, state = between(prepared, result, state, is_last)
        if checkpoint is not None:
            checkpoint.write(state)
    return dataclasses.replace(state.end, rounds=state.rounds), state


def _adjust(
    prepared: Prepared, state: State, checkpoint: Checkpoint | None, progress: Progress | None
) -> Result:
    """Adjust the remaining problem, in segments if there is a checkpoint."""

    def solve(problem: Problem, options: SolveOptions, progress: Progress | None) -> Result:
        return solve_prepared(prepared.at(problem, options), progress)

    if checkpoint is None:
        return solve(state.problem, prepared.options, progress)
    from bundle.solving.rounds.checkpoint import solve_in_segments

    return solve_in_segments(
        solve,
        state.problem,
        prepared.options,
        checkpoint.interval,
        so_far=state.so_far,
        progress=progress,
        save=lambda result: checkpoint.write(
            dataclasses.replace(state, problem=result.problem, so_far=result)
        ),
    )


def _is_last(state: State, limits: RoundOptions) -> bool:
    """Return True if no further round follows."""
    if not state.rounds:
        return False
    done = state.rounds[-1]
    change = done.num_observations_removed + state.num_extended
    return done.round >= limits.num_rounds or change < SMALLEST_CHANGE * done.num_observations


def _filtered(prepared: Prepared, state: State, result: Result, limits: RoundOptions) -> State:
    """Return the state after the filter of a round.

    Points that are fixed or named by a factor stay. Control points stay with all observations.
    """
    rules = prepared.applied
    known = touched_ids((*prepared.factors, *(() if rules is None else rules.factors)))["point"]
    filtered = filter_adjusted(
        state.problem,
        limits,
        lambda: prepared.at(state.problem).layout,
        kept_point_ids=sorted({*known, *prepared.options.fixed_point_ids}),
        kept_track_ids=prepared.placed.control_point_ids,
        num_threads=prepared.options.num_threads,
    )
    done = _round_of(len(state.rounds) + 1, result, filtered, limits)
    if filtered.problem.num_observations == 0:
        raise InputError(
            f"num_rounds: the filter of round {done.round} removed all {done.num_observations} "
            f"observations (max_error={limits.max_error:g} min_angle={limits.min_angle:g} "
            f"min_track_length={limits.min_track_length})"
        )
    return state.left(filtered, done)


def _round_of(number: int, result: Result, filtered: Filtered, limits: RoundOptions) -> Round:
    """Return the record of a round."""
    summary, adjusted = result.summary, result.problem
    return Round(
        round=number,
        initial_cost=summary.initial_cost,
        cost=summary.final_cost,
        termination_type=summary.termination_type,
        num_iterations=result.num_steps,
        num_points=adjusted.num_points,
        num_observations=adjusted.num_observations,
        num_observations_removed=filtered.num_observations_removed,
        num_points_removed=filtered.num_points_removed,
        num_observations_beyond_max_error=filtered.num_observations_beyond_max_error,
        num_observations_with_short_track=filtered.num_observations_with_short_track,
        num_observations_below_min_angle=filtered.num_observations_below_min_angle,
        max_error=limits.max_error,
        min_angle=limits.min_angle,
        initial_factor_cost=float(result.factor_costs_before.sum()),
    )
