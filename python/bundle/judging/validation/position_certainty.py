"""Certainty of camera positions in a fit, and the number of parameters that it determines.

The centre of an image is C = -R^T t. For the pose (Exp(w) R, t + dt) it changes by

    dC = -R^T (dt - w x t) = -R^T (dt + [t]_x w),

so that the covariance of C is A P A^T with A = R^T [[t]_x, I] and the covariance P of (w, dt). The
sigma of a position is the root mean square over the three axes, sqrt(trace / 3). It is relative to
the inner gauge, in the unit of the model.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.uncertainty.compute_covariance import covariance
from bundle.errors import InputError
from bundle.model.problem import Problem
from bundle.model.rotations import cross_matrices, rotation_matrices
from bundle.solving.prepare import Prepared
from bundle.solving.result import Result

__all__ = ["Certainty", "certainty", "position_sigmas"]


class Certainty(NamedTuple):
    """Certainty of a fit.

    Attributes:
        position_sigma: median over the images of the sigma of a position; NaN if not computed.
        num_parameters: number of parameters that the fit determines, by rank; 0 if not computed.
        note: reason why the values are not computed.
    """

    position_sigma: float
    num_parameters: int
    note: str = ""


def certainty(prepared: Prepared, full: Result) -> Certainty:
    """Return the certainty of a fit to all observations."""
    try:
        found = covariance(
            full.problem,
            full.options,
            of=("poses",),
            scale="sigma0",
            factors=prepared.factors,
            constraints=() if prepared.applied is None else prepared.applied,  # type: ignore[arg-type]
        )
    except InputError as error:
        return Certainty(float("nan"), 0, str(error))
    sigmas = position_sigmas(full.problem, found.pose_covariance)
    moves = sigmas[sigmas > 0]
    return Certainty(
        position_sigma=float(np.median(moves)) if len(moves) else 0.0,
        num_parameters=full.summary.num_residuals - found.dof,
    )


def position_sigmas(problem: Problem, covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sigma of each image's position from covariances (n, 6, 6) of poses."""
    rotations = rotation_matrices(problem.cam_from_world[:, :4])
    cross = cross_matrices(problem.cam_from_world[:, 4:])
    both = np.concatenate([cross, np.broadcast_to(np.eye(3), cross.shape)], axis=2)
    jacobians = rotations.transpose(0, 2, 1) @ both
    spread = jacobians @ covariances @ jacobians.transpose(0, 2, 1)
    sigmas: NDArray[np.float64] = np.sqrt(np.trace(spread, axis1=1, axis2=2) / 3)
    return sigmas
