"""Leave-one-out residuals of surveyed points, and detection of gross errors.

The similarity fitted without point i predicts this point. d_i is the prediction minus the survey.
Its covariance C_i is the sum of the covariances of the survey, of the point in the model and of the
similarity. d_i is independent of the fit. Let sigma0 be a common factor on all sigmas, estimated
from the residuals of the other points with nu degrees of freedom. For normal errors,

    east and north:  F = d^T C^-1 d / (2 sigma0^2)   has the F distribution with 2 and nu,
    up:              t = d / (sigma0 sqrt(C))        has Student's with nu degrees of freedom

(deletion residuals: Belsley, Kuh and Welsch 1980; data snooping in geodesy: Baarda 1968). sigma0 is
estimated separately for east and north and for up, because the ratio of two stated sigmas is seldom
correct. It is at least 1, so that errors within the stated sigmas do not make a point a suspect. If
the estimate is below 1, nu is infinite.

A point is a suspect if the probability of one of its statistics, multiplied by the number of
statistics (Bonferroni), is below ``LEVEL``: one in twenty blocks without gross errors gets a
suspect. The most improbable point is removed, and the others are tested again without it, until no
suspect remains. Otherwise a gross error would hide a smaller error, and would make neighbouring
points look bad.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.base.tails import f_tail
from bundle.errors import InputError
from bundle.georeference.correspondences import Correspondences
from bundle.georeference.similarity_fit import SimilarityFit, fit_similarity

Array = NDArray[np.float64]

LEVEL = 0.05
"""Probability that a block without gross errors gets a suspect."""

FEWEST = 3
"""Smallest number of points for a similarity."""


@dataclass(frozen=True)
class LeaveOneOut:
    """Predictions of points from the other points.

    Attributes:
        residual: (n, 3) prediction from the others minus survey, east, north, up [m]; nan if the
            others do not determine the model, and for unknown heights.
        sigma: (n, 3) standard deviation of each residual, from the stated sigmas.
        suspect: (n,) True if a gross error is likely.
    """

    residual: Array
    sigma: Array
    suspect: NDArray[np.bool_]


def leave_one_out(
    points: Correspondences,
    control: NDArray[np.bool_],
    tested: NDArray[np.bool_],
    level: float = LEVEL,
) -> LeaveOneOut:
    """Predict each tested point from the control points without it.

    Args:
        points: all points.
        control: (n,) mask of points that determine the similarity.
        tested: (n,) mask of points to predict.
        level: probability that a block without gross errors gets a suspect.
    """
    count = len(points)
    residual, sigma = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    suspect = np.zeros(count, dtype=bool)
    first = True
    while True:
        chances, statistics = np.ones(count), 0
        for index in np.flatnonzero(tested & ~suspect):
            tests = _predicted(points, control & ~suspect, int(index))
            if tests is None:
                continue
            if first:
                residual[index], sigma[index] = tests.residual, tests.sigma
            chances[index] = min(tests.chances)
            statistics += len(tests.chances)
        first = False
        worst = int(np.argmin(chances))
        if statistics == 0 or chances[worst] * statistics >= level:
            return LeaveOneOut(residual, sigma, suspect)
        suspect[worst] = True


@dataclass(frozen=True)
class _Tests:
    residual: Array
    sigma: Array
    chances: list[float]


def _predicted(points: Correspondences, control: NDArray[np.bool_], index: int) -> _Tests | None:
    others = control.copy()
    others[index] = False
    if others.sum() < FEWEST:
        return None
    try:
        fit = fit_similarity(points.rows(others))
    except InputError:  # the others alone are collinear
        return None
    residuals, covariances = fit.predict(points.rows(np.array([index])))
    residual, covariance = residuals[0], covariances[0]
    sigma = np.where(np.isnan(residual), np.nan, np.sqrt(np.diag(covariance)))
    squared = float(residual[:2] @ np.linalg.solve(covariance[:2, :2], residual[:2]))
    sigma0, freedom = _sigma0(fit, slice(0, 2))
    chances = [f_tail(squared / (2 * sigma0**2), 2, freedom)]
    if not math.isnan(residual[2]):
        sigma0, freedom = _sigma0(fit, slice(2, 3))
        # The square of Student's t is F with one degree of freedom.
        chances.append(f_tail((residual[2] / (sigma0 * sigma[2])) ** 2, 1, freedom))
    return _Tests(residual, sigma, chances)


def _sigma0(fit: SimilarityFit, rows: slice) -> tuple[float, float]:
    """Return the factor on the sigmas of some rows, at least 1, and its degrees of freedom."""
    freedom = float(fit.redundancy[:, rows].sum())
    squared = float((fit.whitened[:, rows] ** 2).sum())
    if squared <= freedom or freedom < 1e-6:
        return 1.0, math.inf
    return math.sqrt(squared / freedom), freedom
