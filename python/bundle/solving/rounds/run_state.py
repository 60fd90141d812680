"""State of a run of rounds: the start of the next solve, and masks of the remaining rows."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.problem import Problem
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.solving.measured_result import Round
    from bundle.solving.rounds.filtering import Filtered

_Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False, kw_only=True)
class State:
    """State of a run of rounds.

    Attributes:
        problem: start of the next solve, or the end of the run.
        observation_mask: mask of the remaining observations of the first round's problem.
        point_mask: mask of the remaining points of the first round's problem.
        rounds: completed rounds.
        so_far: result of the current adjustment so far; None at its start.
        end: result of the last adjustment of a complete run; None before.
    """

    problem: Problem
    observation_mask: _Mask
    point_mask: _Mask
    rounds: tuple[Round, ...] = ()
    so_far: Result | None = None
    end: Result | None = None

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
        return State(
            problem=filtered.problem,
            observation_mask=_left_of(self.observation_mask, filtered.observation_mask),
            point_mask=_left_of(self.point_mask, filtered.point_mask),
            rounds=(*self.rounds, done),
        )

    def ended(self, result: Result) -> State:
        """Return the state at the end of the run."""
        return dataclasses.replace(self, end=result)


def _left_of(mask: _Mask, left: _Mask) -> _Mask:
    """Return a mask reduced by `left`, which has one entry per True entry of the mask."""
    out = mask.copy()
    out[mask] = left
    return out
