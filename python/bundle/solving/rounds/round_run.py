"""A run of rounds on one problem: from its start or from a checkpoint, to its end."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.interface.round_options import RoundOptions
from bundle.interface.solve_record import Progress
from bundle.model.problem import Problem
from bundle.solving import solver
from bundle.solving.result import Result
from bundle.solving.round_record import Round
from bundle.solving.rounds.checkpoint import State, check_target, read, write
from bundle.solving.rounds.filtering import Filtered, filter_observations
from bundle.solving.rounds.local_part import touched_ids
from bundle.solving.rounds.segments import num_steps, solve_in_segments

if TYPE_CHECKING:
    from bundle.graphs.factors.factors import Factor
    from bundle.solving.constraints.applied import Applied

__all__ = ["Bounds", "RoundRun"]

SMALLEST_CHANGE = 5e-4
"""Share of its observations that a round has to remove for another one to follow, as in COLMAP
(``ba_global_max_refinement_change``)."""

Bounds = Mapping[tuple[str, int], tuple[ArrayLike, ArrayLike]]


class RoundRun:
    """Rounds on one problem, from its start or from a checkpoint."""

    def __init__(
        self,
        start: Problem,
        options: SolveOptions,
        limits: RoundOptions,
        factors: tuple[Factor, ...],
        bounds: Bounds | None,
        progress: Progress | None,
        control_point_ids: tuple[int, ...] = (),
        applied: Applied | None = None,
    ) -> None:
        self._applied = applied
        self._start, self._options, self._limits = start, options, limits
        self._control_point_ids = control_point_ids
        self._factors, self._bounds, self._progress = factors, bounds, progress
        self._path: Path | None = None
        self._fingerprint: dict[str, Any] = {}
        self._interval = 0
        self._state = State(
            problem=start,
            observation_mask=np.broadcast_to(True, start.num_observations),  # takes no memory
            point_mask=np.broadcast_to(True, start.num_points),
        )

    def keep(
        self,
        checkpoint: Path | None,
        resume: Path | None,
        fingerprint: dict[str, Any],
        interval: int,
    ) -> None:
        """Write checkpoints from now on, and begin where one ended."""
        path = checkpoint if checkpoint is not None else resume
        assert path is not None
        check_target(path)
        self._path, self._fingerprint, self._interval = path, fingerprint, interval
        if resume is not None and resume.exists():
            used, _, _ = solver.settle(
                self._start, self._options, self._factors, self._bounds, self._applied
            )
            self._state = read(resume, self._start, used, fingerprint)

    def to_the_end(self) -> tuple[State, Result]:
        """Adjust and filter; return where that ended and the last adjustment.

        What the last filter has left is adjusted once more, unless it removed nothing: a filter
        changes the objective, and the end is a minimum.
        """
        state = self._state
        if state.has_ended and state.so_far is not None:
            return state, state.so_far
        while True:
            result = self._adjust(state)
            state = dataclasses.replace(state, problem=result.problem, so_far=None)
            if result.summary.interrupted or not result.summary.is_solution_usable:
                return state, result
            has_ended = not self._limits.num_rounds or self._has_all_rounds(state)
            if not has_ended:
                state = self._filter(state, result)
                removed = state.rounds[-1].num_observations_removed
                has_ended = self._has_all_rounds(state) and not removed
            if has_ended:
                state = dataclasses.replace(state, so_far=result, has_ended=True)
            self._save(state)
            if has_ended:
                return state, result

    def _has_all_rounds(self, state: State) -> bool:
        return bool(state.rounds) and _is_last(state.rounds[-1], self._limits)

    def _adjust(self, state: State) -> Result:
        if self._path is None:
            return self._solve(state.problem, self._options, self._progress)
        return solve_in_segments(
            self._solve,
            state.problem,
            self._options,
            self._interval,
            so_far=state.so_far,
            progress=self._progress,
            save=lambda result: self._save(
                dataclasses.replace(state, problem=result.problem, so_far=result)
            ),
        )

    def _solve(self, problem: Problem, options: SolveOptions, progress: Progress | None) -> Result:
        return solver.solve(
            problem,
            options,
            factors=self._factors,
            bounds=self._bounds,
            constraints=() if self._applied is None else self._applied,
            progress=progress,
        )

    def _filter(self, state: State, result: Result) -> State:
        factors = self._factors + (() if self._applied is None else self._applied.factors)
        filtered = _filter_adjusted(
            result.problem, self._limits, self._options, factors, self._control_point_ids
        )
        done = _round_of(len(state.rounds) + 1, result, filtered)
        _check_left(filtered, done, self._limits)
        return State(
            problem=filtered.problem,
            observation_mask=_left_of(state.observation_mask, filtered.observation_mask),
            point_mask=_left_of(state.point_mask, filtered.point_mask),
            rounds=(*state.rounds, done),
        )

    def _save(self, state: State) -> None:
        if self._path is not None:
            write(self._path, state, self._fingerprint)


def _left_of(mask: NDArray[np.bool_], left: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return what is left of a mask, `left` being of what it has."""
    out = mask.copy()
    out[mask] = left
    return out


def _filter_adjusted(
    problem: Problem,
    limits: RoundOptions,
    options: SolveOptions,
    factors: Iterable[Factor],
    control_point_ids: tuple[int, ...],
) -> Filtered:
    """Filter what a round has adjusted.

    Points that are known otherwise stay, and control points with all of their observations.
    """
    known = touched_ids(factors)["point"]
    return filter_observations(
        problem,
        limits.max_error,
        limits.min_angle,
        limits.min_track_length,
        kept_point_ids=sorted({*known, *options.fixed_point_ids}),
        kept_track_ids=control_point_ids,
        num_threads=options.num_threads,
    )


def _round_of(number: int, result: Result, filtered: Filtered) -> Round:
    """Return the record of a round."""
    summary, adjusted = result.summary, result.problem
    return Round(
        round=number,
        initial_cost=summary.initial_cost,
        cost=summary.final_cost,
        termination_type=summary.termination_type,
        num_iterations=num_steps(result),
        num_points=adjusted.num_points,
        num_observations=adjusted.num_observations,
        num_observations_removed=filtered.num_observations_removed,
        num_points_removed=filtered.num_points_removed,
    )


def _is_last(done: Round, limits: RoundOptions) -> bool:
    """Return whether no round follows one."""
    changed = done.num_observations_removed >= SMALLEST_CHANGE * done.num_observations
    return done.round >= limits.num_rounds or not changed


def _check_left(filtered: Filtered, done: Round, limits: RoundOptions) -> None:
    """Raise an InputError if a filter has left nothing."""
    if filtered.problem.num_observations == 0:
        raise InputError(
            f"num_rounds: the filter of round {done.round} removed all {done.num_observations} "
            f"observations (max_error={limits.max_error:g} min_angle={limits.min_angle:g} "
            f"min_track_length={limits.min_track_length})"
        )
