"""Held-out observations: their choice, and their errors in a second fit without them.

A point may lose an observation only if two other images still see it. Fold 0 of three folds
(:mod:`bundle.model.folds`) has this property, and so has any subset of it. In each image, the
requested share is drawn from this fold. So each observation of a point in three or more images has
the same chance, and each image contributes in proportion to its observations. Shares above 30 % are
drawn from fold 0 of two folds, which needs four images of a point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import freeze
from bundle.errors import InputError
from bundle.interface.judging_options import MOST_PERCENT, HoldOutOptions
from bundle.interface.option_fields import number
from bundle.interface.options import SolveOptions
from bundle.io.files import Source, as_problem
from bundle.model.estimates import arrays_of, estimates, with_estimates
from bundle.model.folds import folds_of, keys, mix
from bundle.model.problem import Problem
from bundle.model.residuals import HeldOut, errors_or_nan, summarize_clipped
from bundle.solving.executors import solve_prepared
from bundle.solving.prepare import Prepared, prepare
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.solving.rounds.plan import State

FEWEST_OF_IMAGE = 6
"""Number of observations that remain in each image: twice as many as a pose needs."""

_IN_THREE_FOLDS = 30.0


def hold_out(
    problem: Source, percent: float = 10.0, seed: int = 0
) -> tuple[Problem, NDArray[np.int64]]:
    """Divide the observations of a problem into those to fit and those to predict.

    The choice is random but depends only on the seed and on the ids of images and points. Each
    image loses the same share of its observations, as far as possible. Each point keeps
    observations in at least two images, and each image keeps at least six observations. Several
    observations of a point in one image stay together.

    Args:
        problem: the problem, which is not changed; also the path of one, or a
            pycolmap.Reconstruction.
        percent: share of the observations to hold out, above 0 and at most 50. Fewer are held out
            if only two images see most of the points.
        seed: whole number; another seed gives another choice.

    Returns:
        The problem without the held-out observations, with all its images and points; and the
        indices of the held-out observations in the given problem, ascending.

    Raises:
        InputError: a number is out of range, or no observation can be held out.
        OSError: the path cannot be read.

    Example:
        >>> kept, held = bundle.hold_out(problem, percent=10)
        >>> fitted = bundle.solve(kept).problem
        >>> fields = ("cam_from_world", "camera_params", "points", "rolling_shutter")
        >>> predicted = problem.replace(**{name: getattr(fitted, name) for name in fields})
        >>> errors, _ = bundle.reprojection_errors(predicted)
        >>> errors[held]
    """
    problem = as_problem(problem)
    held = choose(problem, percent, seed)
    return problem.select(observations=~held).problem, np.flatnonzero(held)


def choose(
    problem: Problem,
    percent: float,
    seed: int = 0,
    among: NDArray[np.bool_] | None = None,
    name: str = "percent",
) -> NDArray[np.bool_]:
    """Return a mask of the observations to hold out.

    ``percent``: share of each image's observations, above 0 and at most 50. ``among``: mask of the
    observations that may be held out; None: all.
    """
    percent = number(name, percent, above=0.0, maximum=MOST_PERCENT)
    seed = int(number("seed", seed, minimum=0, whole=True))
    candidates = folds_of(problem, 3 if percent <= _IN_THREE_FOLDS else 2, seed) == 0
    counted = problem.observation_image
    if among is not None:
        candidates &= among
        counted = counted[among]
    seen = np.bincount(counted, minlength=problem.num_images)
    quota = np.floor(seen * percent / 100 + 0.5).astype(np.int64)
    quota = np.minimum(quota, np.maximum(seen - FEWEST_OF_IMAGE, 0))
    rows = np.flatnonzero(candidates)
    image, point = problem.observation_image[rows], problem.observation_point[rows]
    # A second mix: the rank of an image at its point depends on the key itself.
    draw = mix(keys(seed, problem.image_ids[image], problem.point_ids[point]))
    order = np.lexsort((draw, image))
    image, draw, rows = image[order], draw[order], rows[order]
    place = np.arange(len(rows))
    begins = np.searchsorted(image, np.arange(problem.num_images))
    same = np.zeros(len(rows), bool)  # as the observation before: the same point in the same image
    same[1:] = (image[1:] == image[:-1]) & (draw[1:] == draw[:-1])
    place = np.maximum.accumulate(np.where(same, 0, place))
    held = np.zeros(problem.num_observations, bool)
    held[rows[place - begins[image] < quota[image]]] = True
    if not held.any():
        images = 3 if percent <= _IN_THREE_FOLDS else 4
        if len(rows) and quota.max() == 0 and seen.max() > FEWEST_OF_IMAGE:
            raise InputError(
                f"{name}: expected at least one observation in {percent:g} % of an image, found at "
                f"most {seen.max()} observations in an image"
            )
        raise InputError(
            f"{name}: expected images with more than {FEWEST_OF_IMAGE} observations, and in them "
            f"points that at least {images} images observe, found 0"
        )
    return held


# Errors of held-out observations: a second fit of a prepared solve, without them.
#
# The first fit has all observations. The second fit starts there and has the same factors, rules,
# bounds, rounds and options, but not the held-out observations. At its minimum it no longer depends
# on them, and its errors at them are predictions. Held-out observations are drawn from the problem
# before any filter: an outlier among them counts, at most as the clip.
#
# Both statistics cover the same observations with and without rounds, so that deleting observations
# does not lower them: removed observations keep their errors. A point that the rounds of the second
# fit remove is triangulated again, with the cameras of that fit and from the observations that are
# not held out, by a robust loss. So the cameras of a fit determine its score, not the number of
# points that it drops.
#
# Measurements of control points are never held out. In a local adjustment the observations of the
# named images are candidates: other images are constant and do not change with their observations.

ROBUST_LOSS = "cauchy"
"""Loss of removed points after a least-squares fit: outliers are a reason for removal."""

Fit = Callable[[Prepared], "tuple[Result, State]"]
"""Run of a prepared problem: the result for its start, and the state at its end."""


class HeldOutFit:
    """The observations that a solve holds out, chosen before it runs.

    ``prepared``: the solve of all observations. ``options``: share of the observations and seed.
    """

    def __init__(self, prepared: Prepared, options: HoldOutOptions) -> None:
        self._prepared, self._options = prepared, options
        self._among = _candidates(prepared)
        self._held = choose(
            prepared.start, options.hold_out, options.hold_out_seed, self._among, name="hold_out"
        )

    def measured(self, finished: Result, last: Result, state: State, fit: Fit) -> Result:
        """Return the finished result with the errors of the held-out observations."""
        if not _is_usable(last):
            return finished
        start = with_values(self._prepared.start, last.problem, state)
        kept = start.select(observations=~self._held).problem
        result, end = fit(self._prepared.at(kept))
        if not _is_usable(result):
            return finished
        options = self._prepared.options
        predicted = with_values(start, result.problem, end)
        predicted = triangulated(predicted, ~end.point_mask, self._held, options)
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


def triangulated(
    problem: Problem, removed: NDArray[np.bool_], held: NDArray[np.bool_], options: SolveOptions
) -> Problem:
    """Return the problem with removed points at the minimum of their fitted observations.

    Args:
        removed: mask of the points that the fit removed.
        held: mask of the held-out observations.
    """
    rows = removed[problem.observation_point] & ~held
    if not rows.any():
        return problem
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

    ``refined``: the same cameras, images and points with other values; observations may differ.
    ``state``: state of a run that removed points of `refined`; these points keep their values.
    """
    values = estimates(refined)
    if state is not None and refined.num_points != problem.num_points:
        for name in arrays_of("points"):
            whole = getattr(problem, name).copy()
            whole[state.point_mask] = values[name]
            values[name] = freeze(whole)
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
