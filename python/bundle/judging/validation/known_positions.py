"""Errors of a fit at check points and measured positions, which judge it better than pixels.

Check points do not influence the fit. Measured positions of images are priors of the fit: their
residuals tell whether positions and pixels agree, but a fit with more parameters agrees more.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from bundle.solving.prepare import Prepared
from bundle.solving.result import Result

if TYPE_CHECKING:
    from bundle.solving.placed_problem import Prior


class KnownErrors(NamedTuple):
    """Root mean squares of distances in space, in the unit of the survey; NaN without any.

    Attributes:
        check_points: at check points.
        positions: at measured positions of images.
    """

    check_points: float
    positions: float


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
    """Return the root mean square length; unknown coordinates (NaN) do not count."""
    known = np.isfinite(residuals).any(axis=1)
    if not known.any():
        return float("nan")
    return float(np.sqrt(np.nansum(residuals**2) / known.sum()))
