"""Rounds: adjust, filter, adjust what is left, and so on (COLMAP's iterative refinement)."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from bundle.base.paths import as_path
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.interface.option_fields import choice, number
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import CHECKPOINT_INTERVAL, RESTS, RoundOptions
from bundle.interface.solve_record import Progress
from bundle.io.source import Source, as_problem
from bundle.model.image_selection import ImageSelection, find_images
from bundle.solving import solver
from bundle.solving.placement import place_at_priors
from bundle.solving.result import Result
from bundle.solving.rounds.checkpoint import fingerprint_of_options
from bundle.solving.rounds.input_digest import digest, digest_of_fields, digest_of_order
from bundle.solving.rounds.local_part import LocalPart
from bundle.solving.rounds.rest_prior import marginalize_rest, without_prior
from bundle.solving.rounds.round_run import Bounds, RoundRun

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.model.problem import Problem
    from bundle.solving.constraints.applied import Applied
    from bundle.solving.constraints.constraint_record import RuleEnd
    from bundle.solving.constraints.rule_list import Constraints
    from bundle.solving.constraints.rules import Rule
    from bundle.solving.placement import Prior

__all__ = ["solve_rounds"]


def solve_rounds(
    problem: Source,
    options: SolveOptions | None = None,
    *,
    num_rounds: int = 5,
    max_error: float = 4.0,
    min_angle: float = 1.5,
    min_track_length: int = 2,
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
    progress: Progress | None = None,
    **changes: Any,
) -> Result:
    """Adjust and filter in turns: outliers found after one adjustment do not disturb the next.

    Each round is a :func:`bundle.solve` of what the round before has left, then a
    :func:`bundle.filter_observations`, in the last round too. The rounds end before ``num_rounds``
    when one removes less than 0.05 % of its observations (COLMAP's rule), and when an adjustment
    has no usable solution or was interrupted; what that one adjusted is not filtered. As the filter
    changes the objective, costs of different rounds cannot be compared, and what the last filter
    leaves is adjusted once more: the problem returned is at a minimum.

    Points that are held (``fixed_point_ids``) or that a factor names stay, whatever their track and
    angle are; they lose observations only.

    Args:
        problem: left untouched; also the path of one, or a pycolmap.Reconstruction.
        options: how to adjust, as in :func:`bundle.solve`.
        num_rounds: the maximum; 0: adjust once and filter nothing.
        max_error: as in :func:`bundle.filter_observations`, in pixels.
        min_angle: likewise, in degrees.
        min_track_length: likewise, in observations.
        only_images: refine only these images, the points that they see and their cameras; hold all
            else and leave it as it is, bit for bit. Ids and names, such as ``"1,5-9,left/*.jpg"``
            or ``[1, 5, "left/*.jpg"]``. Only these points, with all their observations, go to the
            solver and the filter. A camera that also took other images is refined, too, unless it
            is in ``fixed_camera_ids`` (``part`` of the result names it).
        rest: with ``only_images``, what all else does. "fixed": other images that see one of these
            points take part, held. "marginal": these neighbours and their cameras move, under the
            exact marginal prior of all that does not take part, linearised at its present values;
            only the named images, their points and cameras are in the result, all else is left bit
            for bit as well. Where nothing holds the world, the neighbours stay where they are on
            average. The cost includes the prior's; ``part.rest`` of the result tells of it.
        factors: beside the observations, as in :func:`bundle.solve`. With the rest marginal those
            that touch neither what is refined nor neighbours alone go into the prior, and have no
            place in ``factor_costs_before`` and ``_after``.
        priors: measured positions of images and control points, as in :func:`bundle.solve`. No
            filter removes a measurement of a control point; counts of points and observations in
            ``rounds`` include control points.
        align: as in :func:`bundle.solve`, before the first round; never with ``only_images``.
        bounds: of camera parameters, as in :func:`bundle.solve`.
        constraints: rules, as in :func:`bundle.solve`. What they say of the start they say of the
            start of the first round. With ``only_images`` a parameter that is shared with a camera
            outside of the part is held. Not with the rest marginal.
        checkpoint: file that is replaced, whole or not at all, after each round and each
            ``checkpoint_interval`` iterations, so that a run that was killed can go on. The solver
            starts anew from what the file holds, whether the run is killed or not: with the option
            ``deterministic`` a resumed run ends where the uninterrupted one does, bit for bit.
        checkpoint_interval: iterations from one checkpoint to the next within a round.
        resume: checkpoint to go on from, with the same problem and options (the number of threads
            may differ); from the start if the file does not exist. Checkpoints go on to be written
            there if ``checkpoint`` names no other file.
        progress: as in :func:`bundle.solve`, in each round.
        **changes: options by name, in place of those in ``options``.

    Returns:
        What the last filter has left, adjusted, beside the problem given. ``rounds`` tells of
        each round; summary, iterations and times are those of the last adjustment.

    Raises:
        InputError: as :func:`bundle.solve` and :func:`bundle.filter_observations`; a filter
            removed all observations; or the checkpoint is none, or one of another problem or with
            other options.
        KeyboardInterrupt, MemoryError: as :func:`bundle.solve`.
        OSError: as :func:`bundle.solve`, or the checkpoint cannot be read or written.
    """
    options = SolveOptions.of(options, changes, "solve_rounds")
    limits = RoundOptions(
        num_rounds=num_rounds,
        max_error=max_error,
        min_angle=min_angle,
        min_track_length=min_track_length,
    )
    rest = choice("rest", rest, RESTS)
    if rest == "marginal" and only_images is None:
        raise InputError("rest: expected with only_images only, found marginal without")
    interval = number("checkpoint_interval", checkpoint_interval, whole=True, minimum=1)
    checkpoint = None if checkpoint is None else as_path(checkpoint, "checkpoint")
    resume = None if resume is None else as_path(resume, "resume")
    given = as_problem(problem)
    if only_images is not None:
        if align:
            raise InputError("align: expected without only_images, which leave the rest in place")
        align = False
    placed = place_at_priors(given, factors, priors, align)
    factors = given_factors = _listed(placed.factors)
    part = None
    if only_images is not None:
        if placed.control_point_ids:
            raise InputError(
                "priors: expected no control points beside only_images, which leave the rest in "
                "place"
            )
        named = find_images("only_images", given, only_images)
        part = LocalPart(given, named, factors, marginal=rest == "marginal")
    start, used, applied = solver.constrained(
        placed.problem, options, constraints, None if part is None else part.refined_ids
    )
    prior, given_bounds = None, bounds
    if part is not None:
        if start is not given:
            part = LocalPart(start, named, factors)
        check_observed(part)
        factors = part.factors
        if rest == "marginal":
            if applied is not None:
                raise InputError("rest: expected fixed with constraints, found marginal")
            prior = marginalize_rest(given, part, used, bounds)
            used = used.replace(gauge="none") if prior.holds_gauge else used
            factors += () if prior.factor is None else (prior.factor,)
        start, used, bounds = part.problem, part.options(used), part.bounds(bounds)
        applied = None if applied is None else applied.restricted(start)
    run = RoundRun(
        start, used, limits, factors, bounds, progress, placed.control_point_ids, applied
    )
    if checkpoint is not None or resume is not None:
        fingerprint = plain_fingerprint(digest(given), options, interval) | {
            **limits.asdict(),
            "only_images": None if part is None else part.named_ids,
            **({} if prior is None else {"rest": rest}),
            **({"order": digest_of_order(given)} if limits.num_rounds > 0 else {}),
            "factors and bounds": digest_of_fields(
                _without_places(given_factors, given_bounds, placed.targets, applied)
            ),
        }
        run.keep(checkpoint, resume, fingerprint, interval)
    state, result = run.to_the_end()
    record = None if part is None else part.record
    if prior is not None and record is not None:
        result, record = without_prior(result, record, prior)
    refined = placed.result(state.problem)
    return dataclasses.replace(
        result,
        problem=(
            refined
            if part is None
            else part.merge(state.problem, state.observation_mask, state.point_mask)
        ),
        initial_problem=given,
        options=result.options if part is None else restored(result.options, options),
        rounds=state.rounds,
        similarity=placed.similarity,
        control_points=placed.control_points(refined) if part is None else (),
        constraints=() if applied is None else _rule_ends(applied, placed.problem, state.problem),
        part=record,
    )


def plain_fingerprint(
    input_digest: str, options: SolveOptions, checkpoint_interval: int
) -> dict[str, Any]:
    """Return the fingerprint of a run without rounds, parts, factors, bounds and rules."""
    return {
        "input": input_digest,
        **fingerprint_of_options(options),
        **RoundOptions().asdict(),
        "checkpoint_interval": checkpoint_interval,
        "only_images": None,
        "factors and bounds": digest_of_fields(_without_places((), None, None, None)),
    }


def _without_places(factors: Any, bounds: Any, targets: Any, applied: Applied | None) -> Any:
    """Return what decides a run, without where its rules stood."""
    rules = None if applied is None else dataclasses.replace(applied, rules=())
    given = [factors, bounds, *(part for part in (targets, rules) if part is not None)]
    return tuple(given)


def _rule_ends(applied: Applied, before: Problem, after: Problem) -> tuple[RuleEnd, ...]:
    from bundle.solving.constraints.ends import rule_ends

    return rule_ends(applied, before, after)


def _listed(factors: Iterable[Factor]) -> tuple[Factor, ...]:
    if isinstance(factors, tuple | list):
        return tuple(factors)
    from bundle.graphs.factors.variables import as_list

    return as_list("factors", "factors", factors)


def restored(used: SolveOptions, given: SolveOptions) -> SolveOptions:
    """Return the options as used, without what a part holds beyond what was asked for."""
    return used.replace(
        fixed_image_ids=given.fixed_image_ids,
        fixed_camera_ids=given.fixed_camera_ids,
        fixed_point_ids=given.fixed_point_ids,
        refine_sensor_from_rig=given.refine_sensor_from_rig,
        fixed_sensors=given.fixed_sensors,
    )


def check_observed(part: LocalPart) -> None:
    """Raise an InputError if the images of a part see no points."""
    if part.problem.num_observations == 0:
        raise InputError(
            f"only_images: expected images that see points, found none in "
            f"{plural(part.record.num_images, 'image')}"
        )
