"""AIC and BIC of candidates from their fits, with the number of parameters by rank.

A fit minimises C = 1/2 sum rho(||r||^2). For Gaussian noise with variance s^2 and the trivial loss,
-2 log L = 2 C / s^2 + constant, and

    AIC = 2 C / s^2 + 2 p,    BIC = 2 C / s^2 + p log n,

with p free parameters and n residuals. A robust loss takes the place of the squares; its
dispersion takes the place of the variance (Ronchetti 1985, Statistics & Probability Letters 3;
Machado 1993, Econometric Theory 9):

    s^2 = E[psi^2] / E[psi'],    psi(r) = rho'(||r||^2) r.

Both expectations are means over the residuals of the candidate with the most parameters, so that
systematic errors of smaller candidates do not count as noise. psi' is the mean over the two
directions of the derivative of psi: rho' + rho'' ||r||^2. For the trivial loss s^2 is the mean of
r^2 per coordinate. Criteria compare candidates
with one loss; each loss has a dispersion of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.interface.options import SolveOptions
from bundle.model.losses import evaluate_loss


def dispersion(lengths: NDArray[np.float64], options: SolveOptions) -> float:
    """Return s^2 from the lengths of residuals, in sigmas; NaN lengths do not count."""
    lengths = lengths[np.isfinite(lengths)]
    if not len(lengths):
        return float("nan")
    squares = lengths**2
    _, first, second = evaluate_loss(options.loss, options.loss_scale, squares).T
    slope = np.mean(first + second * squares)
    return float(np.mean(first**2 * squares) / 2 / slope) if slope > 0 else float("nan")


def information_criteria(
    cost: float, variance: float, num_parameters: int, num_residuals: int
) -> tuple[float, float]:
    """Return AIC and BIC, up to a constant that all candidates share."""
    if not variance > 0:
        return float("nan"), float("nan")
    fit = 2 * cost / variance
    return fit + 2 * num_parameters, fit + num_parameters * float(np.log(num_residuals))
