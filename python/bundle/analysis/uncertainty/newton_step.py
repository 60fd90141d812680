"""One Newton step at the values of a problem, and variances there, by one factorisation."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem


def newton_step(
    problem: Problem,
    options: SolveOptions,
    functions: NDArray[np.float64] | None = None,
    *,
    of_poses: bool = False,
) -> dict[str, Any]:
    """Return the Newton step of the observations alone, with all refined variables free.

    The keys are "predicted_decrease" of the cost, "steps" (num_images, 6) of the poses as (w, t),
    "weighted_squares", "num_residuals", "num_parameters" and "gauge_degrees". The residuals have
    the loss's weights.

    Args:
        problem: the problem.
        options: options of its solve.
        functions: (m, num_images, 6 + width) linear functions of the pose (w, t) and of the camera
            parameters of each image; "functions" (m, m) is their covariance in the inner gauge.
        of_poses: True for "poses" (num_images, 6, 6), their covariances in this gauge.

    Raises:
        InputError: something is not determined, or the sums overflow.
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
