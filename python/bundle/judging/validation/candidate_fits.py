"""Fits of all candidates, to all observations and without each fold, and their predictions.

Candidates form chains of one sharing, one loss and one set of refined variables, from the smallest
model to the largest. A fit starts at the nearest of these problems, each with the candidate's
cameras: the input, the fit of the model before, and, where images have lenses of their own, the
fits of the same model with shared lenses; nearest means the lowest clipped RMSE. Without the last
start, a fit with individual focal lengths could end at a higher cost than the shared lens, which is
a special case of it. Each fold starts at the candidate's fit to all observations. A minimum does
not depend on its start, so that the fit without a fold no longer depends on the fold; unconverged
fits are marked.

Solves of one thread each run side by side: for problems of usual size this uses the cores better
than one solve on all of them, and its sums have a fixed order.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import field, replace
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.editing.camera_sharing import split_cameras
from bundle.errors import InputError
from bundle.georeference.measurements import move_models
from bundle.interface.options import SolveOptions
from bundle.judging.validation.candidates import (
    Candidate,
    groups_of,
    is_shared,
    tying_rules,
    with_cameras,
)
from bundle.model.losses import evaluate_loss
from bundle.model.problem import Problem
from bundle.model.residuals import errors_or_nan, linearize, residuals, summarize_clipped
from bundle.planning.comparison.recommendation import command_line
from bundle.solving.executors import ThisProcess, solve_prepared
from bundle.solving.hold_out import with_values
from bundle.solving.prepare import Prepared, prepare
from bundle.solving.request import SolveRequest
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior


_MOST_SIDE_BY_SIDE = 1_000_000
"""Number of observations above which solves run one after another, each on all cores."""

Progress = Callable[[int, int, str], None]
"""Function of the number of solves done, the number of all, and the name of the last."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Fitting:
    """Settings that all candidates share."""

    problem: Problem  # the input
    folds: NDArray[np.int16]  # fold of each observation; -1: it is never held out
    options: SolveOptions  # options of the solves; loss and refined variables are the candidate's
    priors: tuple[Prior, ...] = ()  # measured positions of images, and control points
    rules: tuple[Any, ...] = ()  # rules in addition to those of the sharing
    progress: Progress | None = None  # function called after each solve; None: no function


@dataclass(eq=False, kw_only=True)
class CandidateFit:
    """Fits of one candidate; residuals are NaN without a projection."""

    candidate: Candidate  # the candidate
    prepared: Prepared | None = None  # its prepared solve
    full: Result | None = None  # fit to all observations, with the observations of control points
    # (num_observations, 2) residuals of this fit [pixels]
    residuals: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    # (num_observations, 2) residuals of the fits that did not see the observation
    held_out: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))
    is_converged: bool = True  # True if all fits converged
    num_iterations: int = 0  # number of iterations of all fits
    error: str = ""  # reason why the candidate has no fit; "" if it has

    @property
    def refined(self) -> Problem:
        """The input with the values of the fit to all observations."""
        assert self.prepared is not None
        assert self.full is not None
        return self.prepared.placed.taken_from(self.full.problem)


def fit_candidates(candidates: Sequence[Candidate], fitting: Fitting) -> list[CandidateFit]:
    """Return the fits of all candidates, in their order. Without a valid start: none."""
    fits = [CandidateFit(candidate=candidate) for candidate in candidates]
    chains: dict[Any, list[CandidateFit]] = {}
    for fit in fits:
        one = fit.candidate
        chains.setdefault((one.share, one.loss, one.refine), []).append(fit)
    num_folds = int(fitting.folds.max(initial=-1)) + 1
    threads = fitting.options.num_threads or os.cpu_count() or 1
    large = fitting.problem.num_observations > _MOST_SIDE_BY_SIDE
    workers, each = (1, threads) if large else (threads, 1)
    run = _Run(fitting, len(fits) * (num_folds + 1), each)
    with ThreadPoolExecutor(workers) as pool:
        try:
            shared: list[CandidateFit] = []
            for are_shared in (True, False):
                chosen = [
                    one for one in chains.values() if is_shared(one[0].candidate) == are_shared
                ]
                _finish([pool.submit(run.chain, chain, shared) for chain in chosen])
                shared = [fit for chain in chosen for fit in chain]
            jobs = [(fit, fold) for fit in fits if not fit.error for fold in range(num_folds)]
            _finish([pool.submit(run.fold, *job) for job in jobs])
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return fits


def _finish(futures: list[Future[None]]) -> None:
    for future in futures:
        future.result()


class _Run:
    """Solves of one validation, each in a thread of its own."""

    def __init__(self, fitting: Fitting, count: int, num_threads: int) -> None:
        self._given, self._count, self._done = fitting, count, 0
        self._options = fitting.options.replace(num_threads=num_threads)
        self._lock = Lock()

    def chain(self, chain: list[CandidateFit], others: Sequence[CandidateFit] = ()) -> None:
        """Fit the models of one sharing to all observations, one after another."""
        before: list[Problem] = []
        for fit in chain:
            share = fit.candidate.share
            usable = [one for one in others if not one.error]
            same = [one for one in usable if replace(one.candidate, share=share) == fit.candidate]
            try:
                self._fit(fit, [*before, *(one.refined for one in same)])
            except InputError as error:
                fit.error = str(error)
            else:
                before = [fit.refined]
            self._tell(fit.candidate.name)

    def _fit(self, fit: CandidateFit, others: Sequence[Problem]) -> None:
        candidate, given = fit.candidate, self._given
        may_move = "poses" in candidate.refine and not given.options.fixed_image_ids
        keep_scale = may_move and not given.rules
        start, ties = with_cameras(given.problem, candidate, keep_scale=keep_scale)
        for other in others:
            start = self._nearest(start, other, candidate)
        request = SolveRequest(
            problem=start,
            options=self._options.replace(loss=candidate.loss, refine=candidate.refine),
            priors=given.priors,
            align=True if move_models(given.priors) else None,
            constraints=(*given.rules, *ties),
        )
        fit.prepared = prepare(request)
        result = self._solve(fit, fit.prepared)
        if not result.summary.is_solution_usable:
            raise InputError(result.summary.message)
        fit.full = result
        fit.residuals = self._residuals(result.problem)
        fit.held_out = np.full_like(fit.residuals, np.nan)

    def _nearest(self, start: Problem, fitted: Problem, candidate: Candidate) -> Problem:
        """Return the start with the lower clipped RMSE: as given, or at another fit."""
        try:
            other, _ = with_cameras(fitted, candidate)
        except InputError:
            return start
        errors = [errors_or_nan(each, self._options.cheirality, 1) for each in (start, other)]
        rmse = [summarize_clipped(each).clipped_rmse for each in errors]
        return other if rmse[1] < rmse[0] else start

    def fold(self, fit: CandidateFit, fold: int) -> None:
        """Fit all observations but those of a fold, and predict these."""
        prepared, full = fit.prepared, fit.full
        assert prepared is not None
        assert full is not None
        start = with_values(prepared.start, full.problem)
        count = self._given.problem.num_observations
        kept = np.ones(start.num_observations, bool)
        kept[:count] = self._given.folds != fold
        result = self._solve(fit, prepared.at(start.select(observations=kept).problem))
        found = self._residuals(with_values(start, result.problem))
        held = ~kept[:count]
        fit.held_out[held] = found[held] if result.summary.is_solution_usable else np.nan
        self._tell(fit.candidate.name)

    def _solve(self, fit: CandidateFit, prepared: Prepared) -> Result:
        result = solve_prepared(prepared, None, ThisProcess())
        if result.summary.interrupted:
            raise KeyboardInterrupt
        with self._lock:
            fit.num_iterations += len(result.iterations["cost"]) - 1
            fit.is_converged &= result.summary.termination_type == "CONVERGENCE"
        return result

    def _residuals(self, problem: Problem) -> NDArray[np.float64]:
        found = residuals(problem, self._options.cheirality)
        of_input = slice(self._given.problem.num_observations)
        return np.where(found.counted[:, None], found.xy, np.nan)[of_input]

    def _tell(self, name: str) -> None:
        with self._lock:
            self._done += 1
            if self._given.progress is not None:
                self._given.progress(self._done, self._count, name)


# Normalised errors of held-out observations, AIC and BIC, and the command of a candidate.
#
# A held-out residual r of a point X contains the noise of the measurement and the error of X, which
# comes from the noise of the observations that were fitted. With equal noise sigma, poses and
# lenses known, and the Jacobian J (2, 3) of the projection with respect to X, its covariance is
#
#     sigma^2 S,    S = I + J_h (sum over fitted observations J^T J)^-1 J_h^T,
#
# where h is the held-out observation. The normalised error sqrt(r^T S^-1 r) / sigma has the same
# distribution for all observations, so that points with little parallax do not decide. S comes from
# one candidate for all, because each candidate's own S would favour uncertain candidates. The
# median of r^T S^-1 r is 1.3863 sigma^2 for Gaussian noise (2 log 2, chi-square of two degrees of
# freedom); outliers hardly move it. sigma, too, is common to all candidates.
#
# Observations with a sigma of their own have J and r divided by it.


MEDIAN_OF_TWO = 2 * np.log(2.0)  # median of the chi-square distribution of two degrees of freedom

_Floats = NDArray[np.float64]


def prediction_covariances(
    problem: Problem, folds: NDArray[np.int16], cheirality: str = "auto"
) -> _Floats:
    """Return S of each observation at the fit to all observations; NaN without a fold (-1)."""
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
        is_split = candidate.share in ("each", "focal")
        words.append("--split-cameras" if is_split else f"--share-cameras {candidate.share}")
    if problem.format == "bal" and candidate.camera_model not in ("", "RADIAL"):
        words.append("--format colmap")  # BAL has no other model
    if candidate.share == "focal":
        rules = tying_rules(split_cameras(problem), candidate)
        words += [f"--set {shlex.quote(rule)}" for rule in rules]
    return " ".join(words)
