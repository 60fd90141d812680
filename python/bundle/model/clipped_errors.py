"""Robust statistics of reprojection errors: each error counts at most as the clip.

A model may have no projection of an observation that it was not fitted to: the point is behind the
camera, or outside the range of the lens. This error has no finite value. One point near the
camera's plane has an error of many thousand pixels, and would decide a mean of squares alone. The
clipped RMSE limits both: sqrt(mean min(e, clip)^2), with e = clip if there is no projection.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.model.problem import Problem
from bundle.model.reprojection import counted_errors, reprojection_errors, resolve_cheirality

CLIP = 4.0
"""Clip in pixels: COLMAP's largest error of an inlier (``filter_max_reproj_error``)."""


@dataclass(frozen=True, kw_only=True)
class ClippedErrors:
    """Statistics of reprojection errors in pixels.

    Attributes:
        num_observations: number of observations, with and without a projection.
        rmse: sqrt(mean ||r||^2) over the observations with a projection; not clipped.
        median: median over all observations; infinite if most have no projection.
        clipped_rmse: the RMSE of errors that count at most as the clip.
        share_clipped: share of observations that count as the clip.
        clip: largest error that counts, in pixels.
        num_without_projection: number of observations without a projection.
    """

    num_observations: int
    rmse: float
    median: float
    clipped_rmse: float
    share_clipped: float
    clip: float
    num_without_projection: int


@dataclass(frozen=True, kw_only=True)
class HeldOut(ClippedErrors):
    """Errors of observations that a fit did not see, and those of the observations that it saw.

    The statistics themselves are of the held-out observations.

    Attributes:
        percent: share of the observations that was requested.
        seed: seed of the choice.
        fitted: the same statistics of the other observations, in the same fit.
        is_converged: True if that fit converged; if not, it may still know the held-out
            observations from its start, the fit to all observations.
    """

    percent: float
    seed: int
    fitted: ClippedErrors
    is_converged: bool


def errors_or_nan(
    problem: Problem, cheirality: str = "auto", num_threads: int = 0
) -> NDArray[np.float64]:
    """Return the reprojection error of each observation; NaN if it does not count."""
    cheirality = resolve_cheirality(problem, cheirality)
    errors, behind = reprojection_errors(problem, cheirality=cheirality, num_threads=num_threads)
    return np.where(counted_errors(errors, behind, cheirality), errors, np.nan)


def summarize_clipped(errors: NDArray[np.float64], clip: float = CLIP) -> ClippedErrors:
    """Return the statistics of errors in pixels, NaN without a projection."""
    found = np.isfinite(errors)
    clipped = np.minimum(np.where(found, errors, clip), clip)
    with np.errstate(over="ignore"):  # a huge error may overflow
        rmse = math.sqrt(np.mean(errors[found] ** 2)) if found.any() else math.nan
    count = len(errors)
    return ClippedErrors(
        num_observations=count,
        rmse=rmse,
        median=_median(np.where(found, errors, np.inf)),
        clipped_rmse=math.sqrt(np.mean(clipped**2)) if count else math.nan,
        share_clipped=float(np.mean(clipped >= clip)) if count else math.nan,
        clip=clip,
        num_without_projection=count - int(found.sum()),
    )


def _median(values: NDArray[np.float64]) -> float:
    """Return the median, the mean of the two middle values; they may be infinite."""
    if not len(values):
        return math.nan
    half = len(values) // 2
    low, high = np.partition(values, [half - (len(values) % 2 == 0), half])[
        [half - (len(values) % 2 == 0), half]
    ]
    return float(low if low == high else (low + high) / 2)
