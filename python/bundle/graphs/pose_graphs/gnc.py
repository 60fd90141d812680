"""Graduated non-convexity (GNC) for truncated least squares: edges are inliers or outliers.

The truncated loss min(x, c^2), x = ||r||^2, is x for an inlier and a constant for an outlier. It
has so many local minima that a solve hardly leaves its start. Yang, Antonante, Tzoumas and Carlone
("Graduated non-convexity for robust spatial perception", 2020) minimise

    sum_e  w_e x_e + mu (1 - w_e) / (mu + w_e) c^2

over poses and weights in turn, from mu near 0, where it is convex, to mu -> infinity, where it is
the truncated loss. For given residuals the optimal weights are

    w = 1                              where x <= mu / (mu + 1) c^2,
    w = 0                              where x >= (mu + 1) / mu c^2,
    w = c sqrt(mu (mu + 1) / x) - mu   in between.

c^2 is the 99.95 % quantile of chi2 with the degrees of freedom of an edge, multiplied by the square
of the requested scale: one correct edge in 2000 is lost.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["graduate", "tls_weights"]

GROWTH = 1.4
"""Factor of mu from one solve to the next, as in the paper."""

MOST_SOLVES = 100
NEARLY = 1e-3
"""Weights this close to 0 or 1 count as 0 or 1."""


def tls_weights(chi2: NDArray[np.float64], mu: float, c_squared: float) -> NDArray[np.float64]:
    """Return the optimal weights for squared errors."""
    between = np.sqrt(c_squared * mu * (mu + 1) / np.maximum(chi2, 1e-300)) - mu
    weights: NDArray[np.float64] = np.clip(between, 0, 1)
    return weights


def graduate(
    chi2: NDArray[np.float64],
    doubted: NDArray[np.bool_],
    c_squared: float,
    solve: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    largest: float | None = None,
) -> tuple[NDArray[np.float64], int]:
    """Find edge weights by a sequence of weighted solves.

    Args:
        chi2: (m,) squared errors that give the first weights.
        doubted: (m,) True for edges that may be outliers.
        c_squared: chi2 above which an edge is an outlier.
        solve: function from weights (m,) to chi2 (m,) at the poses of a solve with these weights,
            from which the next one starts.
        largest: largest chi2 for which the loss is convex at first; by default that of ``chi2``.

    Returns:
        Weights (m,), all 0 or 1 unless the limit of solves was reached, and the number of solves.
    """
    weights = np.ones(len(chi2))
    worst = max(largest or 0.0, float(chi2[doubted].max(initial=0.0)))
    if worst <= c_squared:
        return weights, 0
    mu = c_squared / (2 * worst - c_squared)
    for count in range(1, MOST_SOLVES + 1):
        found = tls_weights(chi2[doubted], mu, c_squared)
        weights[doubted] = found
        chi2 = solve(weights)
        if (np.minimum(found, 1 - found) < NEARLY).all() and mu > 1:
            weights[doubted] = np.round(found)
            return weights, count
        mu *= GROWTH
    return weights, MOST_SOLVES
