"""Quantities of a model from which findings follow, each measured once and only if needed.

Noise. For Gaussian noise of standard deviation s per coordinate, an error has a Rayleigh
distribution with the median 1.1774 s. `scale` inverts this. The median tolerates outliers up to
half of the observations. Errors below 0.01 px have no consequences, so that s has this floor.

Sample. Above 200,000 observations a sample of the points, with all their observations, has enough
power: each test asks for size as well as significance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.analysis.uncertainty.covariance_result import Covariance
from bundle.interface.options import SolveOptions
from bundle.judging.findings.next_command import NextCommand
from bundle.model.problem import Problem
from bundle.model.reprojection import Linearization, linearize, resolve_cheirality

__all__ = ["Measured", "median_by_group"]

RAYLEIGH_MEDIAN = 1.1774100225154747
SMALLEST_SCALE = 0.01
MOST_OBSERVATIONS = 200_000
CLIP = 5.0
"""Errors in units of s beyond which an observation tells nothing about lenses and images."""
CELLS = 8
"""Cells of an image per side, each with its own scale."""
FEWEST = 30
"""Number of errors from which a cell or an image has a scale of its own."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """A model at its present values, with everything that findings are made of.

    Attributes:
        whole: the model.
        command: maker of command lines.
        options: options of the solve that made the model; the defaults if unknown.
        rounds: rounds of adjusting and filtering in this solve.
        covariance: covariance of intrinsics with scale "sigma0", or None.
        priors: measured positions of images.
        is_minimum: True if a solve with these options has just converged.
    """

    whole: Problem
    command: NextCommand
    options: SolveOptions = field(default_factory=SolveOptions)
    rounds: int = 0
    covariance: Covariance | None = None
    priors: Sequence[Any] = ()
    is_minimum: bool = False

    @cached_property
    def problem(self) -> Problem:
        """The model, or a sample of its points with all their observations."""
        whole = self.whole
        step = -(-whole.num_observations // MOST_OBSERVATIONS)
        if step < 2:
            return whole
        return whole.select(observations=whole.observation_point % step == 0).problem

    @cached_property
    def _residuals(self) -> tuple[Floats, NDArray[np.bool_]]:
        cheirality = resolve_cheirality(self.problem, self.options.cheirality)
        xy, behind = _core.reprojection_residuals(
            self.problem, self.options.num_threads, cheirality
        )
        counted = np.isfinite(xy[:, 0]) & np.isfinite(xy[:, 1])
        if cheirality != "algebraic":
            counted &= ~behind
        return xy, counted

    @property
    def residuals(self) -> Floats:
        """(n, 2) projection minus measurement [px]."""
        return self._residuals[0]

    @property
    def counted(self) -> NDArray[np.bool_]:
        """(n,) True for observations that count."""
        return self._residuals[1]

    @cached_property
    def errors(self) -> Floats:
        """(n,) lengths of the residuals [px]; NaN where an observation does not count."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.where(self.counted, np.hypot(*self.residuals.T), np.nan)

    @cached_property
    def scale(self) -> float:
        """Standard deviation s of a coordinate [px], robust, at least 0.01."""
        known = self.errors[self.counted]
        return _scale(float(np.median(known))) if len(known) else SMALLEST_SCALE

    @cached_property
    def image_scale(self) -> Floats:
        """(num_images,) scale of each image; NaN with fewer than 30 observations."""
        return self._scales(self.problem.observation_image, self.problem.num_images)

    @cached_property
    def local_scale(self) -> Floats:
        """(n,) largest of the scales of the model, of the image, and of the place in the image.

        Blurred images and wrong lenses have large errors in one image or at one place. Outliers
        are large compared with their surroundings.
        """
        problem = self.problem
        camera = problem.image_camera[problem.observation_image]
        size = np.maximum(problem.camera_sizes[camera], 1)
        cell = np.clip((problem.observation_xy / size * CELLS).astype(np.int64), 0, CELLS - 1)
        models = np.unique(np.array(problem.camera_models, dtype=str), return_inverse=True)[1]
        group = (models.reshape(-1)[camera] * CELLS + cell[:, 0]) * CELLS + cell[:, 1]
        place = self._scales(group, int(group.max(initial=-1)) + 1)[group]
        image = self.image_scale[problem.observation_image]
        local: Floats = np.fmax(np.fmax(place, image), self.scale)
        return local

    @cached_property
    def is_outlier(self) -> NDArray[np.bool_]:
        """(n,) True beyond 5 scales of the surroundings, and for observations without a value."""
        with np.errstate(invalid="ignore"):
            return ~(self.errors <= CLIP * self.local_scale)

    @cached_property
    def is_clean(self) -> NDArray[np.bool_]:
        """(n,) True for observations whose track has no outlier, which would move its point."""
        point = self.problem.observation_point
        spoiled = np.zeros(self.problem.num_points, bool)
        spoiled[point[self.is_outlier]] = True
        return ~spoiled[point]

    @cached_property
    def linearization(self) -> Linearization:
        """Residuals and derivatives of all observations of `problem`."""
        return linearize(self.problem, self.options.cheirality)

    def _scales(self, group: NDArray[Any], count: int) -> Floats:
        known = self.counted
        medians, numbers = median_by_group(self.errors[known], group[known], count)
        scales = np.maximum(medians / RAYLEIGH_MEDIAN, SMALLEST_SCALE)
        scales[numbers < FEWEST] = np.nan
        return scales


def median_by_group(
    values: Floats, group: NDArray[Any], count: int
) -> tuple[Floats, NDArray[np.int64]]:
    """Return the lower median of each group, NaN if empty, and the number of its values."""
    number = np.bincount(group, minlength=count)
    order = np.lexsort((values, group))
    first = np.cumsum(number) - number
    median = np.full(count, np.nan)
    filled = number > 0
    median[filled] = values[order[(first + (number - 1) // 2)[filled]]]
    return median, number


def _scale(median: float) -> float:
    return max(median / RAYLEIGH_MEDIAN, SMALLEST_SCALE)
