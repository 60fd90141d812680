"""Residuals and reprojection errors at a problem's current values, and their statistics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.arrays import check_shape
from bundle.base.records import dataclass
from bundle.interface.analysis_options import NOT_CHECKABLE
from bundle.interface.option_fields import choice, number
from bundle.interface.options import CHEIRALITIES
from bundle.model.cameras import reach
from bundle.model.problem import Problem

RAYLEIGH_MEDIAN = 1.1774100225154747  # median length of two standard normal numbers
_Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ReprojectionError:
    """Statistics of the reprojection errors ||r|| in pixels.

    ``rmse`` is sqrt(mean ||r||^2). Observations behind their camera, and observations whose
    projection does not exist, are counted separately. Unless ``cheirality`` is "algebraic", the
    statistics leave them out. All statistics are NaN if they include no observation.
    """

    rmse: float
    mean: float
    median: float
    p95: float
    max: float
    num_observations: int
    num_behind_camera: int


class Linearization(NamedTuple):
    """Residuals and their derivatives, one row per observation."""

    residual: NDArray[np.float64]  # (N, 2) projection minus measurement, in pixels
    # (N, 2, 6) derivative w.r.t. the pose (w, t) of the observation's image. The rotation is Exp(w)
    # R, where R is the rotation in the problem; w in radians, t in the length unit
    d_pose: NDArray[np.float64]
    # (N, 2, width) derivative w.r.t. the parameters of the camera, in COLMAP's order; zero in
    # columns beyond the parameters of its model
    d_params: NDArray[np.float64]
    d_point: NDArray[np.float64]  # (N, 2, 3) derivative with respect to the point
    # (N, 2, 6) derivative w.r.t. the twist of the observation's image; zero for global shutters
    d_twist: NDArray[np.float64]


def resolve_cheirality(problem: Problem, cheirality: str) -> str:
    """Return the cheirality that "auto" means for this problem.

    "algebraic" for BAL, and if every lens formula is defined beyond 90 degrees. "zero" if no lens
    formula is defined there. "auto" if it depends on the lens or the angle; the core then decides.
    """
    cheirality = choice("cheirality", cheirality, CHEIRALITIES)
    if cheirality != "auto":
        return cheirality
    if problem.format == "bal":
        return "algebraic"
    used = set(problem.image_camera.tolist())
    found = {reach(problem.camera_models[camera]) for camera in used}
    if found <= {"front"}:
        return "zero"
    return "algebraic" if found == {"all"} else "auto"


def reprojection_errors(
    problem: Problem, *, cheirality: str = "auto", num_threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return errors and mask as :func:`bundle.reprojection_errors`, which also takes paths."""
    cheirality = choice("cheirality", cheirality, CHEIRALITIES)
    num_threads = number("num_threads", num_threads, minimum=0, whole=True)
    return _core.reprojection_errors(problem, num_threads, cheirality)


def reprojection_error(
    problem: Problem, cheirality: str = "auto", *, num_threads: int = 0
) -> ReprojectionError:
    """Return statistics of the reprojection errors that count under ``cheirality``."""
    errors, behind = reprojection_errors(problem, cheirality=cheirality, num_threads=num_threads)
    return summarize_errors(errors, behind, resolve_cheirality(problem, cheirality))


def counted_errors(
    errors: NDArray[np.float64], behind: NDArray[np.bool_], cheirality: str
) -> NDArray[np.bool_]:
    """Return a mask of the errors that count.

    `cheirality` is the resolved value with which `behind` was computed.
    """
    counted = ~np.isnan(errors)
    if cheirality != "algebraic":
        counted &= ~behind
    return counted


def summarize_errors(
    errors: NDArray[np.float64], behind: NDArray[np.bool_], cheirality: str
) -> ReprojectionError:
    """Return statistics of the output of `reprojection_errors`; the errors are reordered.

    `cheirality` is the resolved value with which `behind` was computed.
    """
    counted = counted_errors(errors, behind, cheirality)
    if not counted.all():
        errors = errors[counted]
    with np.errstate(over="ignore"):  # valid problems may overflow
        sums = errors.sum(), (errors**2).sum(), errors.max(initial=0.0)
    # Quantiles come last because they reorder the errors.
    return statistics_of(len(errors), sums, lambda: quantiles(errors, [0.5, 0.95]), behind.sum())


def statistics_of(
    count: int,
    sums: Sequence[float],
    median_and_p95: Callable[[], Iterable[float]],
    num_behind: int,
) -> ReprojectionError:
    """Return the statistics of a number of errors; ``sums``: their sum, of squares, and largest."""
    total, squares, largest = sums if count else (math.nan,) * 3
    median, p95 = median_and_p95() if count else (math.nan, math.nan)
    return ReprojectionError(
        rmse=float(np.sqrt(squares / max(count, 1))),
        mean=float(total / max(count, 1)),
        median=median,
        p95=p95,
        max=float(largest),
        num_observations=count,
        num_behind_camera=int(num_behind),
    )


def quantiles(values: NDArray[np.float64], shares: list[float]) -> list[float]:
    """Return np.quantile(values, shares) without its imports, which take 25 ms.

    The values are reordered.
    """
    last = len(values) - 1
    positions = [share * last for share in shares]
    bounds = [(int(position), min(int(position) + 1, last)) for position in positions]
    values.partition([index for pair in bounds for index in pair])
    return [
        between(float(values[below]), float(values[above]), position - below)
        for position, (below, above) in zip(positions, bounds, strict=True)
    ]


def between(low: float, high: float, share: float) -> float:
    """Return low + share (high - low), also for infinite values."""
    return low if low == high or share == 0 else low + share * (high - low)


def linearize(
    problem: Problem, cheirality: str = "auto", *, rotation_offsets: ArrayLike | None = None
) -> Linearization:
    """Return the residuals and analytic Jacobians of all observations, as used in a solve.

    Args:
        problem: the problem; the evaluation is at its values.
        cheirality: as in a solve; rows of observations that it ignores are zero.
        rotation_offsets: (num_images, 3) values of w at which to evaluate; 0 by default.
    """
    shape = (problem.num_images, 3)
    offsets = np.zeros(shape) if rotation_offsets is None else np.asarray(rotation_offsets, float)
    check_shape("rotation_offsets", offsets, shape)
    cheirality = resolve_cheirality(problem, cheirality)
    return Linearization(*_core.linearize(problem, cheirality, np.ascontiguousarray(offsets)))


# Signed residuals of all observations: projection minus measurement, in pixels.
#
# ``bundle.reprojection_errors`` has only their lengths. Lens errors show in the directions.


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of the observations of a problem.

    Attributes:
        xy: (num_observations, 2) projection minus measurement [pixels], x right, y down; across a
            seam the shorter way; NaN if the point has no projection.
        counted: (num_observations,) True for observations that count: the point has a projection
            and, unless cheirality is "algebraic", is in front of the camera.
    """

    xy: NDArray[np.float64]
    counted: NDArray[np.bool_]

    @property
    def lengths(self) -> NDArray[np.float64]:
        """(num_observations,) lengths [pixels]; NaN without a projection."""
        return np.hypot(self.xy[:, 0], self.xy[:, 1])


def standardized_errors(problem: Problem, errors: _Floats, given: tuple[Any, Any, Any]) -> _Floats:
    """Return (n,) standardized errors [px]; ``errors`` (n,) where the leverage is unknown.

    The residual along an eigenvector u of the leverages h (``core/covariance/reliability.h``) has
    the deviation sqrt(1 - h) sigma (W. Baarda, 1968). NaN: no direction is checkable, with 1 - h
    of at least 0.02. ``given``: arguments of the core.
    """
    out = _core.reliability(problem, *given, NOT_CHECKABLE, 0, False)
    known = out["weights"] > 0
    u, least = out["along"][known], out["least"][known]
    most = 2 - out["leverages"][known][:, ::2].sum(axis=1) - least
    redundancies = np.stack([least, most], axis=1)
    x, y = out["residuals"][known].T
    along = np.stack([u[:, 0] * x + u[:, 1] * y, u[:, 0] * y - u[:, 1] * x], axis=1)
    own = along**2 / np.where(redundancies < NOT_CHECKABLE, np.nan, redundancies)
    squares = np.where(np.isnan(own).all(axis=1), np.nan, np.nansum(own, axis=1))
    sigma = 1.0 if problem.observation_sigma is None else problem.observation_sigma[known]
    found = errors.copy()
    found[known] = sigma * np.sqrt(squares / out["weights"][known])
    return found


def residuals(problem: Problem, cheirality: str = "auto") -> Residuals:
    """Return the residuals at the current values of a problem.

    Args:
        problem: the problem; not modified.
        cheirality: "algebraic", "zero" or "auto", as in :class:`SolveOptions`.
    """
    cheirality = resolve_cheirality(problem, cheirality)
    xy, behind = _core.reprojection_residuals(problem, 0, cheirality)
    counted = np.isfinite(xy[:, 0]) & np.isfinite(xy[:, 1])
    if cheirality != "algebraic":
        counted &= ~behind
    return Residuals(xy, counted)


# Robust statistics of reprojection errors: each error is limited to the clip.
#
# A model may have no projection of an observation that it was not fitted to: the point is behind
# the camera, or outside the range of the lens. This error has no finite value. One point near the
# camera's plane has an error of many thousand pixels, and would decide a mean of squares alone. The
# clipped RMSE limits both: sqrt(mean min(e, clip)^2), with e = clip if there is no projection.

CLIP = 4.0  # clip in pixels: COLMAP's largest error of an inlier (``filter_max_reproj_error``)


@dataclass(frozen=True, kw_only=True)
class ClippedErrors:
    """Statistics of reprojection errors in pixels.

    Attributes:
        num_observations: number of observations, with and without a projection.
        rmse: sqrt(mean ||r||^2) over the observations with a projection; not clipped.
        median: median over all observations; infinite if most have no projection.
        clipped_rmse: the RMSE with each error limited to the clip.
        share_clipped: share of observations whose error is limited.
        clip: limit of an error in pixels, and the error without a projection.
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
    """Return the reprojection error of each observation; NaN if it is ignored."""
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


WORST = 5  # default number of images to return

# Number of observations copied at a time: a copy of hundreds of millions takes gigabytes.
_BLOCK = 1 << 20


@dataclass(frozen=True, kw_only=True)
class ImageError:
    """Reprojection errors of one image, in pixels, over the observations that count.

    Attributes:
        image_id: id of the image in the source.
        name: name of the image; "" if the source has no name for it.
        num_observations: number of observations that count.
        rmse: sqrt(mean ||r||^2).
        max: largest ||r||.
    """

    image_id: int
    name: str
    num_observations: int
    rmse: float
    max: float


def worst_images(
    problem: Problem, cheirality: str = "auto", *, most: int = WORST, num_threads: int = 0
) -> tuple[ImageError, ...]:
    """Return the images with the largest RMSE, the worst first.

    Args:
        problem: the problem; errors are evaluated at its values.
        cheirality: as in a solve; observations that it ignores are left out.
        num_threads: number of threads; 0: all cores.
    """
    errors, behind = reprojection_errors(problem, cheirality=cheirality, num_threads=num_threads)
    return worst_of_errors(problem, errors, behind, cheirality, most=most)


def worst_of_errors(
    problem: Problem,
    errors: NDArray[np.float64],
    behind: NDArray[np.bool_],
    cheirality: str = "auto",
    *,
    most: int = WORST,
) -> tuple[ImageError, ...]:
    """Return the worst images from the output of `reprojection_errors`."""
    cheirality = resolve_cheirality(problem, cheirality)
    return worst_of_sums(
        problem,
        *sums_of_images(problem.observation_image, problem.num_images, errors, behind, cheirality),
        most,
    )


def sums_of_images(
    observation_image: NDArray[np.int32],
    num_images: int,
    errors: NDArray[np.float64],
    behind: NDArray[np.bool_],
    cheirality: str,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return for each image the number, sum of squares and maximum of the errors that count.

    `cheirality` is the resolved value with which `behind` was computed.
    """
    count = np.zeros(num_images, dtype=np.int64)
    total, largest = np.zeros(num_images), np.zeros(num_images)
    with np.errstate(over="ignore", invalid="ignore"):
        for first in range(0, len(errors), _BLOCK):
            block = slice(first, first + _BLOCK)
            counted = counted_errors(errors[block], behind[block], cheirality)
            image = observation_image[block][counted].astype(np.intp)
            its_errors = errors[block][counted]
            count += np.bincount(image, minlength=num_images)
            np.add.at(total, image, its_errors**2)
            np.maximum.at(largest, image, its_errors)
    return count, total, largest


def worst_of_sums(
    problem: Problem,
    count: NDArray[np.int64],
    total: NDArray[np.float64],
    largest: NDArray[np.float64],
    most: int = WORST,
) -> tuple[ImageError, ...]:
    """Return the images with the largest RMSE, from the output of `sums_of_images`."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        rmse = np.sqrt(total / count)
    seen = np.flatnonzero(count)
    worst = seen[np.argsort(-rmse[seen], kind="stable")][:most]
    return tuple(
        ImageError(
            image_id=int(problem.image_ids[index]),
            name=problem.image_names[index],
            num_observations=int(count[index]),
            rmse=float(rmse[index]),
            max=float(largest[index]),
        )
        for index in worst
    )
