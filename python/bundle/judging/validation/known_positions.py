"""Errors of a fit at check points and measured positions, and the sigmas of its positions.

Check points do not influence the fit. Measured positions of images are priors of the fit: their
residuals show whether positions and pixels agree, but more parameters always improve the agreement.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.covariance_by_input import covariance
from bundle.errors import InputError
from bundle.judging.findings.larger_lens import Step
from bundle.model.problem import Problem
from bundle.model.problem_keys import touched_ids
from bundle.model.residuals import residuals
from bundle.model.rigid_motions import center_jacobians
from bundle.solving.prepare import Prepared
from bundle.solving.result import Result
from bundle.solving.rounds.plan import filter_observations

if TYPE_CHECKING:
    from bundle.georeference.measurements import Prior


class KnownErrors(NamedTuple):
    """Root mean squares of 3-D distances, in the unit of the survey; NaN without any."""

    check_points: float  # at check points
    positions: float  # at measured positions of images


def known_errors(prepared: Prepared, full: Result, priors: Sequence[Prior]) -> KnownErrors:
    """Return the errors of a fit to all observations."""
    nan = float("nan")
    if not priors:
        return KnownErrors(nan, nan)
    from bundle.georeference.prior_alignment import ProblemPriors
    from bundle.georeference.vector_priors import PositionPrior

    finished = prepared.finished(full)
    points = [one.residual for one in finished.control_points if one.role == "check"]
    measured = [prior for prior in priors if isinstance(prior, PositionPrior)]
    positions = ProblemPriors.make(finished.problem, measured).residuals(finished.problem)
    return KnownErrors(_rms(np.array(points).reshape(-1, 3)), _rms(positions))


def _rms(residuals: np.ndarray) -> float:
    """Return the root mean square length; unknown coordinates (NaN) are ignored."""
    known = np.isfinite(residuals).any(axis=1)
    if not known.any():
        return float("nan")
    return float(np.sqrt(np.nansum(residuals**2) / known.sum()))


# Certainty of camera positions in a fit, and the number of parameters that it determines.
#
# The sigma of a position is the root mean square over the three axes, sqrt(trace / 3), in the unit
# of the model. It is relative to the inner gauge, the mean of cameras and points. A few points of
# huge uncertainty, far away or from wrong matches, would decide this mean. The covariance therefore
# leaves out observations beyond 8 times the median error and points with little parallax, which
# hardly determine where a camera is.

LARGEST_ERROR = 8.0  # largest error of an observation, in medians of the errors

SMALLEST_ANGLES = (5.0, 1.5)
"""Smallest parallax of a point in degrees: the first that leaves half of the observations."""


class Certainty(NamedTuple):
    """Certainty of a fit; NaN and 0 are values that are not computed."""

    position_sigma: float  # median over the images of the sigma of a position
    num_parameters: int  # number of parameters that the fit determines, by rank
    # rms standard deviation of the centres, all axes together, without a free similarity
    camera_sigma: float = float("nan")
    note: str = ""  # reason why the values are not computed


def certainty(prepared: Prepared, full: Result) -> Certainty:
    """Return the position sigmas of a fit to all observations."""
    try:
        sound = _sound(prepared, full)
        found = covariance(
            sound,
            full.options,
            of=("poses",),
            scale="sigma0",
            factors=prepared.factors,
            constraints=() if prepared.applied is None else prepared.applied,  # type: ignore[arg-type]
        )
    except InputError as error:
        return Certainty(float("nan"), 0, note=str(error))
    sigmas = position_sigmas(sound, found.pose_covariance)
    moves = sigmas[sigmas > 0]
    removed = full.problem.num_observations - sound.num_observations
    dependent = sum(factor.dependent_residuals for factor in prepared.factors)
    determined = full.summary.num_residuals - 2 * removed - dependent - found.dof
    return Certainty(
        position_sigma=float(np.median(moves)) if len(moves) else 0.0,
        num_parameters=determined + 3 * (full.problem.num_points - sound.num_points),
        camera_sigma=_camera_sigma(prepared, full),
    )


def _camera_sigma(prepared: Prepared, full: Result) -> float:
    """Return the standard deviation of the cameras relative to each other; NaN with rules."""
    if prepared.applied is not None:
        return float("nan")
    try:
        return Step(prepared.placed.taken_from(full.problem), full.options).position_sigma()
    except InputError:
        return float("nan")


def _sound(prepared: Prepared, full: Result) -> Problem:
    """Return the problem without points that would dominate the gauge; points of factors stay."""
    known = touched_ids(prepared.factors)["point"]
    kept = sorted({*known, *prepared.options.fixed_point_ids})
    lengths = np.hypot(*residuals(full.problem, full.options.cheirality).xy.T)
    largest = max(LARGEST_ERROR * float(np.nanmedian(lengths)), 1e-6)
    for angle in SMALLEST_ANGLES:
        sound = filter_observations(
            full.problem,
            largest,
            angle,
            kept_point_ids=kept,
            kept_track_ids=prepared.placed.control_point_ids,
            num_threads=full.options.num_threads,
        ).problem
        if 2 * sound.num_observations >= full.problem.num_observations:
            return sound
    return full.problem


def position_sigmas(problem: Problem, covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sigma of each image's position from covariances (n, 6, 6) of poses."""
    jacobians = center_jacobians(problem.cam_from_world)
    spread = jacobians @ covariances @ jacobians.transpose(0, 2, 1)
    return np.asarray(np.sqrt(np.trace(spread, axis1=1, axis2=2) / 3))
