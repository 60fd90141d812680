"""Reprojection errors before and after a solve, on the same observations.

A filter that removes large errors lowers the RMSE without any adjustment, and an observation that
loses its projection no longer counts. Both statistics therefore include exactly the observations
that are in the output and have a projection before and after the solve.

A robust loss downweights outliers, so that the RMSE of all observations may rise although the model
has become better. An outlier is an observation whose error exceeds ``OUTLIER`` times the scale of
the loss. The errors that remain are compared on the observations below this limit both before and
after: a choice by only one of them would bias the comparison.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.model.residuals import (
    ReprojectionError,
    counted_errors,
    reprojection_errors,
    resolve_cheirality,
    summarize_errors,
)

OUTLIER = 3.0  # error of an outlier, in scales of the loss


@dataclass(frozen=True, kw_only=True)
class Inliers:
    """Errors without the outliers of a robust loss."""

    limit: float  # error in pixels above which an observation is an outlier
    num_outliers: int  # outliers after the solve
    rmse: float  # RMSE of the other observations after the solve
    num_inliers: int  # observations below the limit before and after the solve
    rmse_before: float  # their RMSE before the solve
    rmse_after: float  # their RMSE after the solve

    @staticmethod
    def of_sums(limit: float, sums: NDArray[np.float64]) -> Inliers:
        """Return the statistics from the output of ``inlier_sums``."""
        num_outliers, count, squares, num_inliers, before, after = sums.tolist()
        return Inliers(
            limit=limit,
            num_outliers=int(num_outliers),
            rmse=_root_mean(squares, count),
            num_inliers=int(num_inliers),
            rmse_before=_root_mean(before, num_inliers),
            rmse_after=_root_mean(after, num_inliers),
        )


@dataclass(frozen=True, kw_only=True)
class KeptErrors:
    """Reprojection errors of the observations in the output."""

    before: ReprojectionError  # statistics at the input
    after: ReprojectionError  # statistics at the output, of the same observations
    # number of observations in the output. The statistics leave out observations without a
    # projection before or after, and include observations behind their camera
    num_observations: int
    # statistics without outliers; None for least squares, and with sigmas of observations
    inliers: Inliers | None = None


@dataclass(frozen=True, kw_only=True)
class Deleted:
    """Numbers of observations, points and images of the input that the output lacks.

    An image whose observations were all deleted is counted, although the output keeps its pose.
    """

    num_observations: int = 0
    num_points: int = 0
    num_images: int = 0

    @staticmethod
    def of(before: Problem, after: Problem) -> Deleted:
        """Return the numbers from the problems before and after deletions."""
        if before.num_observations == after.num_observations:
            return Deleted(num_points=before.num_points - after.num_points)
        seen = [np.count_nonzero(np.bincount(one.observation_image)) for one in (before, after)]
        return Deleted(
            num_observations=before.num_observations - after.num_observations,
            num_points=before.num_points - after.num_points,
            num_images=int(seen[0] - seen[1]),
        )

    @staticmethod
    def of_mask(before: Problem, kept: NDArray[np.bool_] | None) -> Deleted:
        """Return the numbers from the problem before and the mask of its kept observations.

        A point whose observations were all deleted is counted.
        """
        if kept is None:
            return Deleted()
        lost = []
        for rows in (before.observation_point, before.observation_image):
            seen, still = np.bincount(rows), np.bincount(rows[kept], minlength=rows.max() + 1)
            lost.append(int(((seen > 0) & (still == 0)).sum()))
        return Deleted(num_observations=int((~kept).sum()), num_points=lost[0], num_images=lost[1])


@dataclass(frozen=True, eq=False)
class Edit:
    """A change of the input before the solve."""

    edit: str  # its name, such as "camera_model"
    before: Problem  # problem before the change
    after: Problem  # problem after the change, with the same observations


class PixelErrors(NamedTuple):
    """Errors of all observations of a problem."""

    errors: NDArray[np.float64]  # errors ||r|| in pixels; nan without a projection
    behind: NDArray[np.bool_]  # mask of the observations behind their camera
    cheirality: str  # resolved cheirality for ``behind``

    @staticmethod
    def of(problem: Problem, cheirality: str, num_threads: int) -> PixelErrors:
        """Return the errors of a problem."""
        cheirality = resolve_cheirality(problem, cheirality)
        found = reprojection_errors(problem, cheirality=cheirality, num_threads=num_threads)
        return PixelErrors(*found, cheirality)

    @property
    def counted(self) -> NDArray[np.bool_]:
        """Mask of the errors that count."""
        return counted_errors(self.errors, self.behind, self.cheirality)

    def chosen(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> PixelErrors:
        """Return copies of the errors in a mask, or of rows."""
        return PixelErrors(self.errors[rows], self.behind[rows], self.cheirality)


def outlier_limit(problem: Problem, options: SolveOptions) -> float | None:
    """Return the error of an outlier in pixels; None without a loss, or with observation sigmas."""
    if options.loss == "trivial" or problem.observation_sigma is not None:
        return None
    return OUTLIER * options.loss_scale


def _on_both(
    before: PixelErrors, after: PixelErrors, kept: NDArray[np.bool_] | None
) -> tuple[PixelErrors, PixelErrors, bool]:
    """Return the errors of the kept observations that count before and after.

    The flag is True if these are all observations that count; otherwise the errors are copies.
    """
    start = before if kept is None else before.chosen(kept)
    counts, still_counts = start.counted, after.counted
    both = counts & still_counts
    is_all = kept is None and bool((counts == still_counts).all())
    if is_all and both.all():
        return before, after, True
    return start.chosen(both), after.chosen(both), is_all


def inlier_sums(
    before: NDArray[np.float64], after: NDArray[np.float64], limit: float
) -> NDArray[np.float64]:
    """Return sums from which ``Inliers.of_sums`` makes statistics; sums of processes add up."""
    with np.errstate(over="ignore"):
        left = after <= limit
        both = left & (before <= limit)
        return np.array(
            [
                len(after) - left.sum(),
                left.sum(),
                (after[left] ** 2).sum(),
                both.sum(),
                (before[both] ** 2).sum(),
                (after[both] ** 2).sum(),
            ]
        )


class Measured(NamedTuple):
    """Statistics of all observations before and after, and those of the kept observations."""

    before: ReprojectionError
    after: ReprojectionError
    kept: KeptErrors


def measure(
    before: PixelErrors,
    after: PixelErrors,
    kept: NDArray[np.bool_] | None,
    limit: float | None,
    totals: Totals | None = None,
    rows: NDArray[np.intp] | None = None,
) -> Measured | None:
    """Return all statistics; the errors are reordered.

    Args:
        kept: mask of the observations of the input that the output has; None: all.
        limit: error of an outlier in pixels; None: do not separate outliers.
        totals: the processes that hold parts of the observations; None: this one holds all. Only
            the first process gets the statistics.
        rows: rows in the output of the kept observations; None: all, in order.
    """
    totals = Totals() if totals is None else totals
    left = after if rows is None else after.chosen(rows)
    start, end, is_all = _on_both(before, left, kept)
    behind = (before.behind if kept is None else before.behind[kept]).sum(), left.behind.sum()
    numbers = totals.add_up(np.array([not is_all, len(left.errors), *behind]))
    sums = totals.add_up(inlier_sums(start.errors, end.errors, limit)) if limit else None
    is_all = totals.tell(None if numbers is None else not numbers[0])
    joint = None if is_all else (totals.summarize(start), totals.summarize(end))
    first, last = totals.summarize(before), totals.summarize(after)
    if numbers is None or first is None or last is None:
        return None
    compared = [first, last]
    for k, one in enumerate(joint or ()):
        assert one is not None  # as first and last are
        compared[k] = dataclasses.replace(one, num_behind_camera=int(numbers[2 + k]))
    inliers = None if sums is None or limit is None else Inliers.of_sums(limit, sums)
    kept_errors = KeptErrors(
        before=compared[0], after=compared[1], num_observations=int(numbers[1]), inliers=inliers
    )
    return Measured(first, last, kept_errors)


class Totals:
    """Totals over the errors, here of a single process; a subclass adds up several processes."""

    def add_up(self, sums: NDArray[Any]) -> NDArray[Any] | None:
        """Return the sums over all processes; None except in the first process."""
        return sums

    def tell(self, value: Any) -> Any:
        """Return the value of the first process."""
        return value

    def summarize(self, found: PixelErrors) -> ReprojectionError | None:
        """Return statistics of the errors, which may be reordered."""
        return summarize_errors(*found)


def _root_mean(squares: float, count: float) -> float:
    return math.sqrt(squares / count) if count else math.nan
