"""Reprojection errors at a problem's current values."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.errors import InputError
from bundle.interface.option_fields import choice, number
from bundle.interface.options import CHEIRALITIES
from bundle.model.cameras import reach
from bundle.model.problem import Problem


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
    """Residuals and their derivatives, one row per observation.

    Attributes:
        residual: (N, 2) projection minus measurement, in pixels.
        d_pose: (N, 2, 6) derivative by the pose (w, t) of the observation's image. The rotation is
            Exp(w) R, where R is the rotation in the problem; w in radians, t in the length unit.
        d_params: (N, 2, width) derivative by the parameters of the camera, in COLMAP's order; zero
            in columns beyond the parameters of its model.
        d_point: (N, 2, 3) derivative by the point.
        d_twist: (N, 2, 6) derivative by the twist of the observation's image; zero for global
            shutters.
    """

    residual: NDArray[np.float64]
    d_pose: NDArray[np.float64]
    d_params: NDArray[np.float64]
    d_point: NDArray[np.float64]
    d_twist: NDArray[np.float64]


def resolve_cheirality(problem: Problem, cheirality: str) -> str:
    """Return the cheirality that "auto" means for this problem.

    "algebraic" for BAL, and if every lens formula is defined beyond 90 degrees. "zero" if no lens
    formula is defined there. "auto" if it depends on the lens or the angle; the core then decides.

    Raises:
        InputError: the cheirality is unknown.
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
    """Return statistics of the reprojection errors that count under ``cheirality``.

    Raises:
        InputError: an observed image has a camera model that is not supported.
    """
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
    if len(errors) == 0:
        nan = float("nan")
        statistics = {"rmse": nan, "mean": nan, "median": nan, "p95": nan, "max": nan}
    else:
        with np.errstate(over="ignore"):  # valid problems may overflow
            statistics = {
                "rmse": float(np.sqrt(np.mean(errors**2))),
                "mean": float(errors.mean()),
                "max": float(errors.max()),
            }
        # Quantiles come last because they reorder the errors.
        statistics["median"], statistics["p95"] = quantiles(errors, [0.5, 0.95])
    return ReprojectionError(
        **statistics, num_observations=len(errors), num_behind_camera=int(behind.sum())
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
        cheirality: as in a solve; rows of observations that do not count are zero.
        rotation_offsets: (num_images, 3) values of w at which to evaluate; 0 by default.

    Raises:
        InputError: an observed image has a camera model that is not supported, or the offsets have
            the wrong shape.
    """
    shape = (problem.num_images, 3)
    offsets = np.zeros(shape) if rotation_offsets is None else np.asarray(rotation_offsets, float)
    if offsets.shape != shape:
        raise InputError(f"rotation_offsets: expected shape {shape}, found {offsets.shape}")
    cheirality = resolve_cheirality(problem, cheirality)
    return Linearization(*_core.linearize(problem, cheirality, np.ascontiguousarray(offsets)))
