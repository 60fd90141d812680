"""Rounds: adjust, filter, adjust what is left, and so on (COLMAP's iterative refinement)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from bundle import solver
from bundle.errors import InputError
from bundle.io import Source, as_problem
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.result import Result
from bundle.round_record import Round
from bundle.rounds.filtering import Filtered, filter_observations
from bundle.rounds.round_options import RoundOptions
from bundle.solve_record import Progress

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
        factors: beside the observations, as in :func:`bundle.solve`.
        priors: measured positions of images, as in :func:`bundle.solve`.
        align: as in :func:`bundle.solve`, before the first round.
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
    rounds: list[Round] = []
    similarity = None
    while True:
        result = solver.solve(
            current,
            options,
            factors=factors,
            priors=priors,
            align=False if rounds else align,
            bounds=bounds,
            progress=progress,
        )
        similarity = similarity or result.similarity
        is_over = result.summary.interrupted or not result.summary.is_solution_usable
        if is_over or limits.num_rounds == 0:
            current = result.problem
            break
        filtered = filter_adjusted(result.problem, limits, options, factors)
        rounds.append(round_of(len(rounds) + 1, result, filtered))
        current = filtered.problem
        check_left(filtered, rounds[-1], limits)
        if is_last(rounds[-1], limits):
            break
    return dataclasses.replace(
        result,
        problem=current,
        initial_problem=given,
        rounds=tuple(rounds),
        similarity=similarity,
    )


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
