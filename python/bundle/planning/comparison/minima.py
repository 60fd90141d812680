"""Minima at which the methods of a comparison ended.

Solutions within one sigma of that of the lowest cost are at the same minimum: no measurement could
distinguish them. Single points at other positions are ignored. A solution farther away is at
another minimum, or its method stopped too early. To distinguish these cases, one method continues
from each solution at tight tolerances. Solutions whose continuations meet are at one minimum. Costs
alone cannot distinguish them: an early stop and a poor minimum can have the same gap.

The distance between two solutions in sigmas needs no covariance. Let x_a and x_b be two solutions,
r their residuals in sigmas of the observations, J the Jacobian, and W = diag(rho') the weights of
the loss at the solution of the lowest cost. The covariance is C = sigma0^2 (J^T W J)^-1 with
sigma0^2 = r^T W r / (residuals - parameters). The distance

    d^2 = (x_a - x_b)^T C^-1 (x_a - x_b) = ||W^1/2 J (x_a - x_b)||^2 / sigma0^2
        = ||W^1/2 (r_a - r_b)||^2 / sigma0^2        to first order

needs no Jacobian, and does not depend on the gauge: J maps free directions to 0. By Cauchy and
Schwarz it bounds every parameter and every linear combination of parameters v,

    |v^T (x_a - x_b)| <= d sqrt(v^T C v),

with equality for one v (Scheffe's bound). At a minimum x_b the cost rises by d^2 sigma0^2 / 2, so a
relative gap g of the cost is a distance of about sqrt(g (residuals - parameters)): for a million
observations, a gap of 1e-6 is more than one sigma.

A point with an outlier or without parallax often has several minima of its own, which the cameras
do not notice. d^2 is a sum over observations, hence over points. Points that alone contribute more
than one sigma are therefore counted and left out, if they are at most 0.2 % of all: the rest of the
sum bounds all other parameters, for a covariance without the observations of these points.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.interface.options import SolveOptions
from bundle.model.losses import evaluate_loss
from bundle.model.problem import Problem
from bundle.model.reprojection import residuals
from bundle.planning.comparison.measured_run import Method, Run
from bundle.planning.comparison.process import WorkerEnd, restore_solution

SAME = 1.0
"""Distance in sigmas up to which two solutions are at the same minimum."""

Refine = Callable[[Run, Path], WorkerEnd]


def find_minima(
    problem: Problem,
    options: SolveOptions,
    runs: Sequence[Run],
    solutions: Mapping[Method, Path],
    refine: Refine | None,
) -> list[Run]:
    """Return the runs with their distances and minima.

    ``runs``: one run per method. ``solutions``: stored solutions; runs without one keep an unknown
    minimum. ``refine``: continues the solution of a run at tight tolerances and stores the result
    at a path; None to leave distant solutions at an unknown minimum.
    """
    usable = [run for run in runs if run.is_usable and solutions[run.method].exists()]
    if not usable:
        return list(runs)
    best = min(usable, key=lambda run: run.final_cost)
    distance = SolutionDistance(problem, options, solutions[best.method], _redundancy(best))
    apart = {
        run.method: distance.between(solutions[run.method], solutions[best.method])
        for run in usable
    }
    far = [run for run in usable if apart[run.method].sigmas > SAME]
    numbers = {run.method: 0 for run in usable if run not in far}
    if far and refine is not None:
        found = _minima([best, *far], solutions, distance, refine)
        if best.method in found:
            numbers = dict.fromkeys(numbers, found[best.method]) | found
    return [
        dataclasses.replace(
            run,
            distance_in_sigmas=apart[run.method].sigmas,
            num_points_elsewhere=apart[run.method].num_points,
            minimum=numbers.get(run.method, -1),
        )
        if run.method in apart
        else run
        for run in runs
    ]


def _redundancy(run: Run) -> int:
    """Return the number of residuals minus the number of parameters."""
    assert run.measurement is not None  # the caller chose a usable run
    summary = run.measurement.summary
    return summary.num_residuals_reduced - summary.num_parameters_reduced


def _minima(
    runs: Sequence[Run],
    solutions: Mapping[Method, Path],
    distance: SolutionDistance,
    refine: Refine,
) -> dict[Method, int]:
    """Continue the runs; return the number of the minimum of each that converged."""
    ends: list[tuple[float, Method, Path]] = []
    for run in runs:
        target = solutions[run.method].with_suffix(".end.npz")
        summary = (refine(run, target).measurement or {}).get("summary", {})
        if summary.get("termination_type") == "CONVERGENCE" and target.exists():
            ends.append((summary["final_cost"], run.method, target))
    centres: list[Path] = []
    numbers: dict[Method, int] = {}
    for _, method, path in sorted(ends, key=lambda end: end[0]):
        near = (
            k for k, centre in enumerate(centres) if distance.between(path, centre).sigmas <= SAME
        )
        number = next(near, len(centres))
        if number == len(centres):
            centres.append(path)
        numbers[method] = number
    return numbers


MOST_POINTS = 0.002
"""Largest share of points that are left out."""

LEAST_SIGMA0 = 1e-3
"""Least sigma0. Data without noise would make rounding errors many sigmas."""


class Distance(NamedTuple):
    """Distance of two solutions."""

    sigmas: float  # distance without the points that are counted
    num_points: int  # number of points that are at other positions


class SolutionDistance:
    """Distances between stored solutions of one problem.

    Args:
        problem: the problem; its values are not used.
        options: options of the solves.
        best: stored solution of the lowest cost.
        redundancy: number of residuals minus number of parameters.
    """

    def __init__(
        self, problem: Problem, options: SolveOptions, best: Path, redundancy: int
    ) -> None:
        self._problem, self._options = problem, options
        residual = self._residual(best)
        squared = np.where(np.isfinite(residual), residual, 0.0) ** 2
        lengths = squared.sum(axis=1)
        rho = evaluate_loss(options.loss, options.loss_scale, lengths)
        self._weight = rho[:, 1]
        variance = float(self._weight @ lengths) / max(redundancy, 1)
        self._sigma0 = max(math.sqrt(variance), LEAST_SIGMA0)

    def between(self, one: Path, other: Path) -> Distance:
        """Return the distance. Observations without a projection in one solution are ignored."""
        apart = self._residual(one) - self._residual(other)
        squared = (np.where(np.isfinite(apart), apart, 0.0) ** 2).sum(axis=1)
        problem = self._problem
        weighted = self._weight * squared / self._sigma0**2
        of_points = np.bincount(problem.observation_point, weighted, problem.num_points)
        elsewhere = of_points > 1
        if elsewhere.sum() > MOST_POINTS * problem.num_points:
            elsewhere[:] = False
        return Distance(math.sqrt(float(of_points[~elsewhere].sum())), int(elsewhere.sum()))

    def _residual(self, path: Path) -> NDArray[np.float64]:
        """Return (num_observations, 2) residuals in sigmas; NaN where they are ignored."""
        problem = restore_solution(self._problem, path)
        found = residuals(problem, self._options.cheirality)
        xy = np.where(found.counted[:, None], found.xy, np.nan)
        sigma = problem.observation_sigma
        return xy if sigma is None else xy / sigma[:, None]
