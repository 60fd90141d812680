"""Errors of held-out observations: a second fit of a prepared solve, without them.

The first fit has all observations. The second fit starts there and has the same factors, rules,
bounds, rounds and options, but not the held-out observations. At its minimum it no longer depends
on them, and its errors at them are predictions. Held-out observations are drawn from the problem
before any filter: an outlier among them counts, at most as the clip.

Both statistics cover the same observations with and without rounds, so that deleting observations
does not lower them: removed observations keep their errors. A point that the rounds of the second
fit remove is triangulated again, with the cameras of that fit and from the observations that are
not held out, by a robust loss. So a fit is judged by its cameras, not by the number of points that
it gives up.

Measurements of control points are never held out. In a local adjustment the observations of the
named images are candidates: other images are constant and do not change with their observations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import freeze
from bundle.interface.options import SolveOptions
from bundle.interface.validation_options import HoldOutOptions
from bundle.model.clipped_errors import HeldOut, errors_or_nan, summarize_clipped
from bundle.model.estimates import estimates, with_estimates
from bundle.model.problem import Problem
from bundle.solving.executors import solve_prepared
from bundle.solving.held_out.hold_out import choose
from bundle.solving.prepare import Prepared, prepare
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.solving.rounds.run_state import State

ROBUST_LOSS = "cauchy"
"""Loss of removed points after a least-squares fit: outliers are a reason for removal."""

Fit = Callable[[Prepared], "tuple[Result, State | None]"]
"""Solve of a prepared problem: the result for its start, and the state of its rounds."""


class HeldOutFit:
    """The observations that a solve holds out, chosen before it runs.

    Args:
        prepared: the solve of all observations.
        options: share of the observations and seed.

    Raises:
        InputError: no observation can be held out.
    """

    def __init__(self, prepared: Prepared, options: HoldOutOptions) -> None:
        self._prepared, self._options = prepared, options
        self._among = _candidates(prepared)
        self._held = choose(
            prepared.start, options.hold_out, options.hold_out_seed, self._among, name="hold_out"
        )

    def measured(self, finished: Result, last: Result, state: State | None, fit: Fit) -> Result:
        """Return the finished result with the errors of the held-out observations.

        Args:
            finished: result of the fit to all observations.
            last: the same result for the start of that fit.
            state: its rounds; None without rounds.
            fit: function that solves a prepared problem, with rounds if there are any.
        """
        if not _is_usable(last):
            return finished
        start = with_values(self._prepared.start, last.problem, state)
        kept = start.select(observations=~self._held).problem
        result, rounds = fit(self._prepared.at(kept))
        if not _is_usable(result):
            return finished
        options = self._prepared.options
        predicted = with_values(start, result.problem, rounds)
        if rounds is not None:
            predicted = self._triangulated(predicted, ~rounds.point_mask)
        errors = errors_or_nan(predicted, options.cheirality, options.num_threads)
        held = summarize_clipped(errors[self._held])
        record = HeldOut(
            **vars(held),
            percent=self._options.hold_out,
            seed=self._options.hold_out_seed,
            fitted=summarize_clipped(errors[self._among & ~self._held]),
            is_converged=result.summary.termination_type == "CONVERGENCE",
        )
        return replace(finished, held_out=record)

    def _triangulated(self, problem: Problem, removed: NDArray[np.bool_]) -> Problem:
        """Return the problem with removed points at the minimum of their fitted observations."""
        rows = removed[problem.observation_point] & ~self._held
        if not rows.any():
            return problem
        options = self._prepared.options
        part = problem.select(points=removed, observations=rows)
        alone = SolveOptions(
            refine=("points",),
            loss=ROBUST_LOSS if options.loss == "trivial" else options.loss,
            loss_scale=options.loss_scale,
            cheirality=options.cheirality,
            num_threads=options.num_threads,
            check_solution=False,
        )
        prepared = prepare(SolveRequest(problem=part.problem, options=alone))
        points = problem.points.copy()
        points[removed] = solve_prepared(prepared, None).problem.points
        return problem._moved(points=freeze(points))


def with_values(problem: Problem, refined: Problem, state: State | None = None) -> Problem:
    """Return a problem with the values of its refined version, from which points may be missing.

    Args:
        problem: the problem.
        refined: the same cameras, images and points with other values; observations may differ.
        state: rounds that removed points of `refined`; these points keep their values.
    """
    values = estimates(refined)
    if state is not None and refined.num_points != problem.num_points:
        points = problem.points.copy()
        points[state.point_mask] = refined.points
        values["points"] = freeze(points)
    return with_estimates(problem, values)


def _candidates(prepared: Prepared) -> NDArray[np.bool_]:
    """Return a mask of the observations that may be held out."""
    start = prepared.start
    given = ~np.isin(start.point_ids, prepared.placed.control_point_ids)
    among: NDArray[np.bool_] = given[start.observation_point]
    if prepared.part is not None:
        refined = np.isin(start.image_ids, list(prepared.part.refined_ids["image"]))
        among &= refined[start.observation_image]
    return among


def _is_usable(result: Result) -> bool:
    return result.summary.is_solution_usable and not result.summary.interrupted
