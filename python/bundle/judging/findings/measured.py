"""Quantities of a model from which findings follow, each measured once and only if needed.

Noise. For Gaussian noise of standard deviation s per coordinate, an error has a Rayleigh
distribution with the median 1.1774 s. `scale` inverts this. The median tolerates outliers up to
half of the observations. Errors below 0.01 px have no consequences, so that s has this floor.

Sample. Above 200,000 observations a sample of the points, with all their observations, has enough
power: each test requires size and significance.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import distinct, median
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.options import SolveOptions
from bundle.judging.findings.next_command import NextCommand
from bundle.model.cameras import param_kinds
from bundle.model.problem import Problem
from bundle.model.residuals import RAYLEIGH_MEDIAN, Residuals, residuals, standardized_errors
from bundle.solving.layout import lay_out

if TYPE_CHECKING:
    from bundle.georeference.point_check import SurveyChecks

SMALLEST_SCALE = 0.01
MOST_OBSERVATIONS = 200_000
CHEAP_COVARIANCE = 100_000  # work up to which a covariance takes tens of milliseconds
CHEAP_ERRORS = 10_000
"""Work up to which standardized errors take 3 % of the time of a small `bundle refine`."""
CLIP = 5.0  # errors in units of s beyond which an observation is not used for lenses and images
CELLS = 8  # cells of an image per side, each with its own scale
FEWEST = 30  # number of errors from which a cell or an image has a scale of its own

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Measured:
    """A model at its present values, with the quantities that the findings use."""

    whole: Problem  # the model
    command: NextCommand  # object that makes command lines
    # the model before the solve, from which commands start; None: as ``whole``
    start: Problem | None = None
    # options of the solve that made the model; the defaults if unknown
    options: SolveOptions = field(default_factory=SolveOptions)
    # :attr:`bundle.Covariance.lens_sigmas` of the model, or None
    lens_sigmas: tuple[NDArray[np.float64], float] | None = None
    priors: Sequence[Any] = ()  # measured positions of images
    # tests of control points and positions after the solve, or None
    survey: SurveyChecks | None = None
    constraints: Any = ()  # rules of the solve
    is_minimum: bool = False  # True if a solve with these options has just converged

    def of_command(self, command: NextCommand) -> Measured:
        """Return this model with another object that makes command lines."""
        return replace(self, command=command)

    @cached_property
    def problem(self) -> Problem:
        """The model, or a sample of its points with all their observations."""
        whole = self.whole
        step = -(-whole.num_observations // MOST_OBSERVATIONS)
        if step < 2:
            return whole
        return whole.select(observations=whole.observation_point % step == 0).problem

    @cached_property
    def _residuals(self) -> Residuals:
        return residuals(self.problem, self.options.cheirality)

    @property
    def residuals(self) -> Floats:
        """(n, 2) projection minus measurement [px]."""
        return self._residuals.xy

    @property
    def counted(self) -> NDArray[np.bool_]:
        """(n,) True for observations that count."""
        return ~np.isnan(self.errors)

    @cached_property
    def errors(self) -> Floats:
        """(n,) lengths of the residuals [px]; NaN where an observation is ignored."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.where(self._residuals.counted, np.hypot(*self.residuals.T), np.nan)

    @cached_property
    def scale(self) -> float:
        """Standard deviation s of a coordinate [px], robust, at least 0.01."""
        known = self.errors[self.counted]
        return max(median(known) / RAYLEIGH_MEDIAN if len(known) else 0.0, SMALLEST_SCALE)

    @cached_property
    def image_scale(self) -> Floats:
        """(num_images,) scale of each image; NaN with fewer than 30 observations."""
        return self._scales(self.problem.observation_image, self.problem.num_images)

    @cached_property
    def standardized(self) -> Measured:
        """This model with standardized errors, which count where the redundancy is at least 0.02.

        Itself if the model is large (a report affords more), with raw errors if it is singular.
        """
        if self.work > (CHEAP_ERRORS if self.lens_sigmas is None else CHEAP_COVARIANCE):
            return self
        found, used = replace(self), lay_out(self.problem, self.options.replace(num_threads=1), ())
        given = used.options.asdict(), used.limits, used.core_factors()
        with suppress(InputError):  # without full rank, no redundancy is known
            vars(found)["errors"] = standardized_errors(self.problem, self.errors, given)
        return found

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
        """(n,) True for errors above 5 local scales, and for observations without a value."""
        with np.errstate(invalid="ignore"):
            return ~(self.errors <= CLIP * self.local_scale)

    @cached_property
    def is_clean(self) -> NDArray[np.bool_]:
        """(n,) True for observations of tracks without outliers (which would move the point)."""
        point = self.problem.observation_point
        spoiled = np.zeros(self.problem.num_points, bool)
        spoiled[point[self.is_outlier]] = True
        return ~spoiled[point]

    @property
    def work(self) -> int:
        """Work of a covariance or a step: observations plus 20 times the square of the images."""
        return self.whole.num_observations + 20 * self.whole.num_images**2

    @cached_property
    def known_lens_sigmas(self) -> tuple[NDArray[np.float64], float] | None:
        """Sigmas of the intrinsics and sigma0, computed here if that takes milliseconds."""
        whole = self.whole
        if self.lens_sigmas is not None or self.work > CHEAP_COVARIANCE:
            return self.lens_sigmas
        if "focal" not in self.options.refine:
            return None
        from bundle.analysis.uncertainty.covariance_by_input import intrinsics_covariance

        try:
            options = self.options.replace(num_threads=1)
            return intrinsics_covariance(whole, options, self.constraints).lens_sigmas
        except InputError:
            return None

    def _scales(self, group: NDArray[Any], count: int) -> Floats:
        known = self.counted
        medians, numbers = median_by_group(self.errors[known], group[known], count)
        medians[numbers < FEWEST] = np.nan
        return np.maximum(medians / RAYLEIGH_MEDIAN, SMALLEST_SCALE)


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


def principal_points(problem: Problem, camera: NDArray[Any]) -> Floats:
    """Return (n, 2) principal points [px] of cameras by their indices; 0 for models without one."""
    points = np.zeros((problem.num_cameras, 2))
    for index in distinct(camera).tolist():
        kinds = param_kinds(problem.camera_models[index])
        places = [k for k, kind in enumerate(kinds) if kind == "principal_point"]
        if len(places) == 2:
            points[index] = problem.camera_params[index, places]
    return np.asarray(points[camera])


def newton_step(
    problem: Problem,
    options: SolveOptions,
    functions: NDArray[np.float64] | None = None,
    *,
    of_poses: bool = False,
) -> dict[str, Any]:
    """Return the Newton step of the observations alone, with all refined variables free.

    Keys, with the weights of the loss: "steps" (num_images, 6) of the poses as (w, t), the cost's
    "predicted_decrease", "weighted_squares", "num_residuals", "num_parameters", "gauge_degrees".
    ``functions``: (m, num_images, 6 + width) linear functions of the pose (w, t) and of the camera
    parameters of each image; "functions" (m, m) is their covariance in the inner gauge.
    ``of_poses``: True for "poses" (num_images, 6, 6), their covariances in this gauge.
    """
    return _core.covariance(
        problem,
        options.replace(gauge="none", num_threads=1).asdict(),
        None,
        None,
        inner=True,
        sandwich=False,
        of_points=False,
        relative=[],
        long_sums=False,
        of_images=of_poses,
        functions=np.zeros(0) if functions is None else functions,
    )
