"""Fits of all candidates: one to all observations, and one without each fold.

Candidates form chains of one sharing, one loss and one set of refined variables, from the smallest
model to the largest. A fit starts at the nearest of these problems, each with the candidate's
cameras: the input, the fit of the model before, and, where images have lenses of their own, the
fits of the same model with shared lenses; nearest is the lower RMSE, clipped. Without the last,
focal lengths of their own may end in a minimum above that of the shared lens, which they contain.
Each fold starts at the candidate's fit to all observations. A minimum does not depend on its start,
so that the fit without a fold no longer depends on the fold; unconverged fits are marked.

Solves of one thread each run side by side: for problems of usual size this uses the cores better
than one solve on all of them, and its sums have a fixed order.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import field, replace
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.georeference.measurements import move_models
from bundle.interface.options import SolveOptions
from bundle.judging.validation.candidates import Candidate, is_shared, with_cameras
from bundle.model.problem import Problem
from bundle.model.reprojection import errors_or_nan, residuals, summarize_clipped
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
    """Return the fits of all candidates, in their order. A candidate that cannot start has none."""
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
            same = [one for one in others if _differ_in_sharing(one, fit)]
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
        errors = [_clipped_rmse(problem, self._options) for problem in (start, other)]
        return other if errors[1] < errors[0] else start

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


def _differ_in_sharing(fit: CandidateFit, other: CandidateFit) -> bool:
    return not fit.error and replace(fit.candidate, share=other.candidate.share) == other.candidate


def _clipped_rmse(problem: Problem, options: SolveOptions) -> float:
    return summarize_clipped(errors_or_nan(problem, options.cheirality, 1)).clipped_rmse
