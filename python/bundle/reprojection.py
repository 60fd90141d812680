"""Reprojection errors at a problem's current values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.problem import Problem
from bundle.result import ReprojectionError

__all__ = ["reprojection_error", "reprojection_errors", "resolve_cheirality"]


def resolve_cheirality(problem: Problem, cheirality: str) -> str:
    """Return what "auto" means for this problem: "algebraic" for BAL, "zero" otherwise."""
    if cheirality != "auto":
        return cheirality
    return "algebraic" if problem.format == "bal" else "zero"


def reprojection_errors(
    problem: Problem, *, num_threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the reprojection error of each observation.

    Returns:
        ||r|| in pixels, (num_observations,), by the formula also for points behind their camera, NaN
        where it has no value; and whether the point is out of the camera's sight, (num_observations,).

    Raises:
        InputError: an observed image has a camera model that is not supported.
    """
    return _core.reprojection_errors(problem, num_threads)


def reprojection_error(
    problem: Problem, cheirality: str = "auto", *, num_threads: int = 0
) -> ReprojectionError:
    """Return statistics of the reprojection errors that count under ``cheirality``.

    Raises:
        InputError: an observed image has a camera model that is not supported.
    """
    errors, behind = reprojection_errors(problem, num_threads=num_threads)
    counted = ~np.isnan(errors)
    if resolve_cheirality(problem, cheirality) == "zero":
        counted &= ~behind
    errors = errors[counted]
    if len(errors) == 0:
        nan = float("nan")
        statistics = {"rmse": nan, "mean": nan, "median": nan, "p95": nan, "max": nan}
    else:
        median, p95 = np.percentile(errors, [50, 95])
        statistics = {
            "rmse": float(np.sqrt(np.mean(errors**2))),
            "mean": float(errors.mean()),
            "median": float(median),
            "p95": float(p95),
            "max": float(errors.max()),
        }
    return ReprojectionError(
        **statistics, num_observations=len(errors), num_behind_camera=int(behind.sum())
    )
