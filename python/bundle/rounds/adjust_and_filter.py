"""Rounds: adjust, filter, adjust what is left, and so on (COLMAP's iterative refinement)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from bundle import solver
from bundle.errors import InputError
from bundle.image_selection import ImageSelection, find_images
from bundle.io import Source, as_problem
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.result import Result
from bundle.round_record import Round
from bundle.rounds.filtering import Filtered, filter_observations
from bundle.rounds.local_part import LocalPart
from bundle.rounds.round_options import RoundOptions
from bundle.solve_record import Progress
from bundle.words import plural

if TYPE_CHECKING:
    from bundle.georeference import PositionPrior
    from bundle.graph import Factor

__all__ = ["solve_rounds"]

SMALLEST_CHANGE = 5e-4
"""Share of its observations that a round has to remove for another one to follow, as in COLMAP
(``ba_global_max_refinement_change``)."""

_Bounds = Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]]


def solve_rounds(
    problem: Source,
    options: SolveOptions | None = None,
    *,
    num_rounds: int = 5,
    max_error: float = 4.0,
    min_angle: float = 1.5,
    min_track_length: int = 2,
    only_images: ImageSelection | None = None,
    factors: Iterable[Factor] = (),
    priors: Iterable[PositionPrior] = (),
    align: bool | None = None,
    bounds: _Bounds | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> Result:
    """Adjust and filter in turns: outliers found after one adjustment do not disturb the next.

    Each round is a :func:`bundle.solve` of what the round before has left, then a
    :func:`bundle.filter_observations`, in the last round too. The rounds end before ``num_rounds``
    when one removes less than 0.05 % of its observations (COLMAP's rule), and when an adjustment
    has no usable solution or was interrupted; what that one adjusted is not filtered. As the filter
    changes the objective, costs of different rounds cannot be compared.

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
        factors: beside the observations, as in :func:`bundle.solve`.
        priors: measured positions of images, as in :func:`bundle.solve`.
        align: as in :func:`bundle.solve`, before the first round; never with ``only_images``.
        bounds: of camera parameters, as in :func:`bundle.solve`.
        progress: as in :func:`bundle.solve`, in each round.
        **changes: options by name, in place of those in ``options``.

    Returns:
        The problem that the last filter has left, beside the problem given. ``rounds`` tells of
        each round; summary, iterations and times are those of the last adjustment.

    Raises:
        InputError: as :func:`bundle.solve` and :func:`bundle.filter_observations`; or a filter
            removed all observations.
        KeyboardInterrupt, MemoryError, OSError: as :func:`bundle.solve`.
    """
    options = SolveOptions.of(options, changes, "solve_rounds")
    limits = RoundOptions(
        num_rounds=num_rounds,
        max_error=max_error,
        min_angle=min_angle,
        min_track_length=min_track_length,
    )
    given = current = as_problem(problem)
    factors = tuple(factors) if isinstance(factors, list | tuple) else factors
    priors = tuple(priors) if isinstance(priors, Iterable) else priors
    used = options
    part = None
    if only_images is not None:
        if align:
            raise InputError("align: expected without only_images, which leave the rest in place")
        factors, priors = _as_factors(given, factors, priors), ()
        part = LocalPart(given, find_images("only_images", given, only_images), factors)
        current, used, bounds = part.problem, part.options(options), part.bounds(bounds)
        check_observed(part)
    observations, points = np.arange(current.num_observations), np.arange(current.num_points)
    rounds: list[Round] = []
    similarity = None
    while True:
        result = solver.solve(
            current,
            used,
            factors=factors,
            priors=priors,
            align=False if rounds else align,
            bounds=bounds,
            progress=progress,
        )
        similarity = similarity or result.similarity
        current = result.problem
        if result.summary.interrupted or not result.summary.is_solution_usable:
            break
        if limits.num_rounds == 0:
            break
        filtered = filter_adjusted(current, limits, used, factors)
        rounds.append(round_of(len(rounds) + 1, result, filtered))
        check_left(filtered, rounds[-1], limits)
        current = filtered.problem
        observations = observations[filtered.observation_mask]
        points = points[filtered.point_mask]
        if is_last(rounds[-1], limits):
            break
    return dataclasses.replace(
        result,
        problem=current if part is None else part.merge(current, observations, points),
        initial_problem=given,
        options=result.options if part is None else restored(result.options, options),
        rounds=tuple(rounds),
        similarity=similarity,
        part=None if part is None else part.record,
    )


def restored(used: SolveOptions, given: SolveOptions) -> SolveOptions:
    """Return the options as used, without what a part holds beyond what was asked for."""
    return used.replace(
        fixed_image_ids=given.fixed_image_ids,
        fixed_camera_ids=given.fixed_camera_ids,
        fixed_point_ids=given.fixed_point_ids,
    )


def check_observed(part: LocalPart) -> None:
    """Raise an InputError if the images of a part see no points."""
    if part.problem.num_observations == 0:
        raise InputError(
            f"only_images: expected images that see points, found none in "
            f"{plural(part.record.num_images, 'image')}"
        )


def _as_factors(problem: Problem, factors: Iterable[Factor], priors: Any) -> Iterable[Factor]:
    """Return the factors with those of the priors, in the world of the problem."""
    if isinstance(priors, tuple) and not priors:
        return factors
    from bundle.georeference.prior_alignment import ProblemPriors

    return (*factors, *ProblemPriors.make(problem, priors).factors())


def filter_adjusted(
    problem: Problem, limits: RoundOptions, options: SolveOptions, factors: Iterable[Factor]
) -> Filtered:
    """Filter what a round has adjusted; points that are known otherwise stay."""
    keys: list[Any] = [key for factor in factors for key in factor.keys]
    known = {key[1] for key in keys if key[0] == "point"}
    return filter_observations(
        problem,
        limits.max_error,
        limits.min_angle,
        limits.min_track_length,
        kept_point_ids=sorted({*known, *options.fixed_point_ids}),
        num_threads=options.num_threads,
    )


def round_of(number: int, result: Result, filtered: Filtered) -> Round:
    """Return the record of a round."""
    summary, adjusted = result.summary, result.problem
    return Round(
        round=number,
        initial_cost=summary.initial_cost,
        cost=summary.final_cost,
        termination_type=summary.termination_type,
        num_iterations=len(result.iterations["iteration"]) - 1,
        num_points=adjusted.num_points,
        num_observations=adjusted.num_observations,
        num_observations_removed=filtered.num_observations_removed,
        num_points_removed=filtered.num_points_removed,
    )


def is_last(done: Round, limits: RoundOptions) -> bool:
    """Return whether no round follows one."""
    changed = done.num_observations_removed >= SMALLEST_CHANGE * done.num_observations
    return done.round >= limits.num_rounds or not changed


def check_left(filtered: Filtered, done: Round, limits: RoundOptions) -> None:
    """Raise an InputError if a filter has left nothing."""
    if filtered.problem.num_observations == 0:
        raise InputError(
            f"num_rounds: the filter of round {done.round} removed all {done.num_observations} "
            f"observations (max_error={limits.max_error:g} min_angle={limits.min_angle:g} "
            f"min_track_length={limits.min_track_length})"
        )
