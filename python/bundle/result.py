"""What a solve gives back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.summary import Summary

__all__ = ["ReprojectionError", "Result"]


@dataclass(frozen=True, kw_only=True)
class ReprojectionError:
    """Reprojection errors ||r|| over the observations that have one, in pixels.

    ``rmse`` is sqrt(mean ||r||^2). Observations behind their camera, and those whose projection
    does not exist, are counted and, unless ``cheirality`` is "algebraic", left out of the
    statistics. Every number is NaN where there is no observation.
    """

    rmse: float
    mean: float
    median: float
    p95: float
    max: float
    num_observations: int
    num_behind_camera: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Result:
    """A refined problem and how it came about.

    Attributes:
        problem: the refined problem; the input is untouched.
        options: every option as used.
        summary: what the solver says.
        iterations: one array a field of Ceres' IterationSummary, one entry an iteration.
        reprojection_error_before: pixels, at the input.
        reprojection_error_after: pixels, at the output.
        build_time_in_seconds: from the arrays to a solver's problem and back, outside the solver.
        solve_time_in_seconds: inside the solver.
    """

    problem: Problem
    options: SolveOptions
    summary: Summary
    iterations: dict[str, NDArray[np.generic]]
    reprojection_error_before: ReprojectionError
    reprojection_error_after: ReprojectionError
    build_time_in_seconds: float
    solve_time_in_seconds: float
