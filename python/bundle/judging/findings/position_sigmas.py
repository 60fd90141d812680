r"""Standard deviations of measured positions, as a model that was solved with them shows them.

Maximum likelihood (variance components; Foerstner and Wrobel 2016, section 4.2.4): with the
whitened residuals v of an axis and their redundancies

    red_i = 1 - u_i^T C u_i / sigma_i^2,

C the covariance of the antenna in the solution with all priors and u_i the axis, the variances of a
group are multiplied by f = sum v^2 / sum red, and the model is solved again, until f is 1. East and
north are one group, up is the other: receivers know heights several times less well. The RMS of the
residuals alone is too small, because the model follows its positions; repeated, it goes to 0. The
rounds begin with sigmas that are certainly too large: the first solve is then free, and its
residuals show the errors. With sigmas that are far too small, all redundancies are near 0.

A standard deviation has the relative error 1 / sqrt(2 sum red). Below a sum of 10, which is 22 %,
it is not estimated.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.judging.findings.measured import Measured
from bundle.model.problem import Problem
from bundle.model.rigid_motions import cross_matrices, rotation_matrices

FEWEST_REDUNDANT = 10.0
MOST_ROUNDS = 8
TOO_LARGE = 10.0
"""Factor of the first round, on sigmas as the residuals show them."""
SETTLED = 0.05
"""Change of a standard deviation below which the rounds end."""
AXES = slice(0, 2), slice(2, 3)
"""Axes of the groups: east and north, up."""

Floats = NDArray[np.float64]


def sigma_factors(
    measured: Measured, rows: list[int], priors: list[Any], ratio: float
) -> tuple[float | None, float | None] | None:
    """Return the factors on the horizontal and the vertical sigmas; None: not estimated.

    Args:
        measured: a model at the minimum with its priors.
        rows: indices of the images with positions.
        priors: these positions, among ``measured.priors``.
        ratio: about the factor by which the sigmas are too small.

    Returns:
        The factors; None if a solve fails.
    """
    from bundle.analysis.uncertainty.covariance_by_input import covariance
    from bundle.solving.executors import solve_prepared
    from bundle.solving.prepare import prepare
    from bundle.solving.request import SolveRequest

    others = [one for one in measured.priors if all(one is not prior for prior in priors)]
    problem, factors = measured.whole, np.full(2, TOO_LARGE * max(ratio, 1.0))
    known = np.zeros(2, bool)
    options = measured.options.replace(gauge="auto", check_solution=False, num_threads=1)
    for _ in range(MOST_ROUNDS):
        scaled = [_scaled(prior, factors) for prior in priors]
        request = {"priors": [*scaled, *others], "constraints": measured.constraints}
        try:
            prepared = prepare(
                SolveRequest(problem=problem, options=options, align=False, **request)
            )
            result = prepared.finished(solve_prepared(prepared, None))
            if not result.summary.is_solution_usable:
                return None
            problem = result.problem
            found = covariance(
                problem, options.replace(gauge="none"), of="poses", gauge="none", **request
            )
        except InputError:
            return None
        place = {image: k for k, image in enumerate(found.pose_ids.tolist())}
        poses = found.pose_covariance[[place[int(problem.image_ids[row])] for row in rows]]
        sums = _sums(problem, rows, scaled, poses)
        known = sums[:, 1] >= FEWEST_REDUNDANT
        change = np.sqrt(sums[:, 0] / np.maximum(sums[:, 1], 1.0))
        change[~(change > 0)] = 1.0  # nothing is measured, or the fit is exact
        factors = factors * change
        if (np.abs(np.log(change)) < SETTLED).all():
            break
    horizontal, vertical = (
        float(factor) if is_known else None
        for factor, is_known in zip(factors, known.tolist(), strict=True)
    )
    return horizontal, vertical


def _scaled(prior: Any, factors: Floats) -> Any:
    """Return a prior with its standard deviations multiplied."""
    axes = np.array([factors[0], factors[0], factors[1]])
    if prior.sigma is not None:
        return dataclasses.replace(prior, sigma=np.asarray(prior.sigma) * axes)
    return dataclasses.replace(
        prior, covariance=np.asarray(prior.covariance) * np.outer(axes, axes)
    )


def _sums(problem: Problem, rows: list[int], priors: list[Any], covariances: Floats) -> Floats:
    """Return, for each group, the sum of squares and that of the redundancies."""
    poses = problem.cam_from_world[rows]
    back = np.swapaxes(rotation_matrices(poses[:, :4]), 1, 2)
    levers = np.array([np.asarray(prior.lever_arm, float) for prior in priors])
    # The antenna R^T (a - t): its derivative by the rotation w is R^T [a - t]x, by t is -R^T.
    jacobian = np.concatenate([back @ cross_matrices(levers - poses[:, 4:]), -back], axis=2)
    spread = jacobian @ covariances @ np.swapaxes(jacobian, 1, 2)
    antennas = (back @ (levers - poses[:, 4:])[:, :, None])[:, :, 0]
    sums = np.zeros((2, 2))
    for prior, antenna, one in zip(priors, antennas, spread, strict=True):
        position = np.asarray(prior.position, float)
        variance = np.diag(prior.full_covariance)
        for group, axes in enumerate(AXES):
            sums[group, 0] += np.nansum((antenna - position)[axes] ** 2 / variance[axes])
            redundancy = (1.0 - np.diag(one)[axes] / variance[axes])[np.isfinite(position[axes])]
            sums[group, 1] += redundancy.sum()
    return sums
