"""Normalised errors of held-out observations, AIC and BIC, and the command of a candidate.

A held-out residual r of a point X contains the noise of the measurement and the error of X, which
comes from the noise of the observations that were fitted. With equal noise sigma, poses and lenses
known, and the Jacobian J (2, 3) of the projection by X, its covariance is

    sigma^2 S,    S = I + J_h (sum over fitted observations J^T J)^-1 J_h^T,

where h is the held-out observation. The normalised error sqrt(r^T S^-1 r) / sigma has the same
distribution for all observations, so that points with little parallax do not decide. S comes from
one candidate for all, because each candidate's own S would favour uncertain candidates. The median
of r^T S^-1 r is 1.3863 sigma^2 for Gaussian noise (2 log 2, chi-square of two degrees of freedom);
outliers hardly move it. sigma, too, is common to all candidates.

Observations with a sigma of their own have J and r divided by it.
"""

from __future__ import annotations

import shlex

import numpy as np
from numpy.typing import NDArray

from bundle.editing.camera_sharing import split_cameras
from bundle.interface.options import SolveOptions
from bundle.judging.validation.candidates import Candidate, groups_of, tying_rules
from bundle.model.losses import evaluate_loss
from bundle.model.problem import Problem
from bundle.model.reprojection import linearize
from bundle.planning.comparison.recommendation import command_line

MEDIAN_OF_TWO = 2 * np.log(2.0)
"""Median of the chi-square distribution of two degrees of freedom."""

_Floats = NDArray[np.float64]


def prediction_covariances(
    problem: Problem, folds: NDArray[np.int16], cheirality: str = "auto"
) -> _Floats:
    """Return S of each observation at a fit to all; NaN for observations in no fold (-1)."""
    jacobians = linearize(problem, cheirality).d_point
    if problem.observation_sigma is not None:
        jacobians = jacobians / problem.observation_sigma[:, None, None]
    point, count = problem.observation_point, problem.num_points
    products = jacobians.transpose(0, 2, 1) @ jacobians
    of_point = _sums(products, point, count)
    covariances = np.full((len(folds), 2, 2), np.nan)
    for fold in range(int(folds.max(initial=-1)) + 1):
        held = np.flatnonzero(folds == fold)
        left = of_point - _sums(products[held], point[held], count)
        # A point that its fitted observations do not determine gets a huge covariance.
        scale = np.trace(left, axis1=1, axis2=2)
        left[:, [0, 1, 2], [0, 1, 2]] += np.where(scale > 0, 1e-12 * scale, 1.0)[:, None]
        inverse = np.linalg.inv(left)[point[held]]
        spread = jacobians[held] @ inverse @ jacobians[held].transpose(0, 2, 1)
        covariances[held] = np.eye(2) + spread
    return covariances


def squared_errors(residuals: _Floats, covariances: _Floats) -> _Floats:
    """Return r^T S^-1 r of residuals (..., n, 2); NaN without a projection."""
    (a, b), (_, d) = covariances[:, 0].T, covariances[:, 1].T
    x, y = residuals[..., 0], residuals[..., 1]
    squares: _Floats = (d * x * x - 2 * b * x * y + a * y * y) / (a * d - b * b)
    return squares


def normalized_errors(residuals: _Floats, covariances: _Floats) -> tuple[_Floats, float]:
    """Return the normalised errors of all candidates, NaN without a projection, and sigma."""
    squares = squared_errors(residuals, covariances)
    medians = np.median(np.where(np.isnan(squares), np.inf, squares), axis=1)
    # The best candidate: a lens that is too small would take its systematic errors for noise.
    sigma = float(np.sqrt(medians.min() / MEDIAN_OF_TWO))
    tiny = float(np.finfo(float).tiny)  # exact data have no noise
    return np.sqrt(squares) / max(sigma, tiny), sigma


def _sums(matrices: _Floats, index: NDArray[np.int32], count: int) -> _Floats:
    sums = np.empty((count, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            sums[:, i, j] = sums[:, j, i] = np.bincount(index, matrices[:, i, j], count)
    return sums


# AIC and BIC of candidates from their fits, with the number of parameters by rank.
#
# A fit minimises C = 1/2 sum rho(||r||^2). For Gaussian noise with variance s^2 and the trivial
# loss, -2 log L = 2 C / s^2 + constant, and
#
#     AIC = 2 C / s^2 + 2 p,    BIC = 2 C / s^2 + p log n,
#
# with p free parameters and n residuals. A robust loss takes the place of the squares; its
# dispersion takes the place of the variance (Ronchetti 1985, Statistics & Probability Letters 3;
# Machado 1993, Econometric Theory 9):
#
#     s^2 = E[psi^2] / E[psi'],    psi(r) = rho'(||r||^2) r.
#
# Both come from the residuals of the candidate with the most parameters, so that systematic errors
# of smaller candidates do not count as noise. A fit follows its noise: the sum of psi^2 is divided
# by the degrees of freedom, residuals minus parameters (Huber 1981, "Robust statistics", section
# 7.6), as tracks of two images leave only one residual in four. psi' is the mean over the two
# directions of the derivative of psi: rho' + rho'' ||r||^2. For the trivial loss s^2 is the sum of
# r^2 per degree of freedom. Criteria compare candidates with one loss; each loss has a dispersion
# of its own.


def dispersion(lengths: NDArray[np.float64], dof: int, options: SolveOptions) -> float:
    """Return s^2 from lengths of residuals in sigmas (NaN ignored); NaN without dof."""
    lengths = lengths[np.isfinite(lengths)]
    if not len(lengths) or dof <= 0:
        return float("nan")
    squares = lengths**2
    _, first, second = evaluate_loss(options.loss, options.loss_scale, squares).T
    slope = np.mean(first + second * squares)
    return float(np.sum(first**2 * squares) / dof / slope) if slope > 0 else float("nan")


def information_criteria(
    cost: float, variance: float, num_parameters: int, num_residuals: int
) -> tuple[float, float]:
    """Return AIC and BIC, up to a constant that all candidates share."""
    if not variance > 0:
        return float("nan"), float("nan")
    fit = 2 * cost / variance
    return fit + 2 * num_parameters, fit + num_parameters * float(np.log(num_residuals))


def refine_command(
    problem: Problem,
    candidate: Candidate,
    options: SolveOptions,
    source: str = "INPUT",
    output: str = "OUTPUT",
) -> str:
    """Return the `bundle refine` command of a candidate."""
    options = options.replace(loss=candidate.loss, refine=candidate.refine)
    words = [command_line(options, source, output)]
    used = {problem.camera_models[camera] for camera in set(problem.image_camera.tolist())}
    if candidate.camera_model and used != {candidate.camera_model}:
        words.append(f"--camera-model {candidate.camera_model}")
    own, wanted = groups_of(problem, "input"), groups_of(problem, candidate.share)
    if own.tobytes() != wanted.tobytes() or candidate.share == "focal":
        words.append(_sharing(candidate.share))
    if problem.format == "bal" and candidate.camera_model not in ("", "RADIAL"):
        words.append("--format colmap")  # BAL has no other model
    if candidate.share == "focal":
        rules = tying_rules(split_cameras(problem), candidate)
        words += [f"--set {shlex.quote(rule)}" for rule in rules]
    return " ".join(words)


def _sharing(share: str) -> str:
    if share in ("each", "focal"):
        return "--split-cameras"
    return f"--share-cameras {share}"
