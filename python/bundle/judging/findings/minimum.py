"""Not refined: a step of a solve would lower the cost by much.

Test. At a minimum the gradient by each point vanishes, whatever else was held constant. With
g = J^T W r and H = J^T W J of one point, its own Newton step lowers the cost 1/2 sum w e^2 by
1/2 g^T H^-1 g. The sum over the points, relative to the cost, is a lower bound of what a step of
all parameters achieves. W are the weights rho'(e^2) of the loss of the solve. An unknown loss is
tried: squares, soft_l1 and cauchy at 1 px; the smallest decrease counts.

Threshold. 20 % of the cost. Nine models that others refined: at most 1.6 %. Starts of synthetic
scenes and triangulated rig models: 60 % or more. Other tests need a minimum and are left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.interface.finding import Finding
from bundle.judging.findings.measured import Measured
from bundle.model.losses import evaluate_loss
from bundle.model.reprojection import linearize

__all__ = ["not_refined"]

DECREASE = 0.2
MOST_OBSERVATIONS = 20_000

Floats = NDArray[np.float64]


def not_refined(measured: Measured) -> Finding | None:
    """Return the finding about a model that is not at a minimum, or None."""
    if measured.is_minimum or "points" not in measured.options.refine:
        return None
    decrease = _decrease(measured)
    if not decrease > DECREASE:
        return None
    return Finding(
        kind="not_refined",
        sentence=f"The model is not refined: better points alone would lower the cost by "
        f"{100 * decrease:.0f} %. Judge it after a refinement.",
        command=measured.command.refine(),
        evidence={"decrease": decrease},
    )


def _decrease(measured: Measured) -> float:
    """Return the smallest relative decrease over the losses that may have made the model."""
    problem = measured.problem
    step = -(-problem.num_observations // MOST_OBSERVATIONS)
    usable = measured.counted & (problem.observation_point % step == 0)
    usable &= ~np.isin(problem.point_ids, measured.options.fixed_point_ids)[
        problem.observation_point
    ]
    part = problem.select(observations=usable).problem
    if not part.num_observations:
        return 0.0
    found = linearize(part, measured.options.cheirality)
    residual, jacobian = found.residual, found.d_point
    if part.observation_sigma is not None:
        residual = residual / part.observation_sigma[:, None]
        jacobian = jacobian / part.observation_sigma[:, None, None]
    options = measured.options
    losses = [(options.loss, options.loss_scale)]
    if options.loss == "trivial":
        losses += [("soft_l1", 1.0), ("cauchy", 1.0)]
    order = np.argsort(part.observation_point, kind="stable")
    point, residual, jacobian = part.observation_point[order], residual[order], jacobian[order]
    starts = np.flatnonzero(np.diff(point, prepend=-1))
    squares = (residual**2).sum(axis=1)
    if not np.isfinite(squares).all():
        return 0.0
    return min(
        _of_points(residual, jacobian, starts, evaluate_loss(*loss, squares)[:, 1])
        for loss in losses
    )


def _of_points(
    residual: Floats, jacobian: Floats, starts: NDArray[np.int64], weight: Floats
) -> float:
    """Return the relative decrease of sum w ||r||^2 by one step of each point."""
    total = float((weight * (residual**2).sum(axis=1)).sum())
    weighted = jacobian * weight[:, None, None]
    normal = np.add.reduceat(np.swapaxes(weighted, 1, 2) @ jacobian, starts)
    gradient = np.add.reduceat((weighted * residual[:, :, None]).sum(axis=1), starts)
    norm = np.sqrt(np.einsum("nii->ni", normal))
    norm[~(norm > 0)] = 1.0
    scaled = normal / norm[:, :, None] / norm[:, None, :]
    # Two rays without parallax leave the depth undetermined; damping removes it from the step.
    step = np.linalg.solve(scaled + 1e-9 * np.eye(3), (gradient / norm)[:, :, None])[:, :, 0]
    decrease = float((step * gradient / norm).sum())
    return decrease / total if total > 0 else 0.0
