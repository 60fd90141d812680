"""Uniform B-splines of degree five: four continuous derivatives, all of them exact.

The basis function of degree n lives on [0, n + 1] and is a polynomial q_k^n(u) on each [k, k + 1],
u = t - k. Cox and de Boor give it from degree n - 1:

    n q_k^n(u) = (u + k) q_k^{n-1}(u) + (n + 1 - k - u) q_{k-1}^{n-1}(u),   q_0^0 = 1.

Between knots j and j + 1 the spline is sum_i q_{n-i}^n(u) c_{j+i} over the n + 1 control points
that reach there. A control point has most influence, and is said to stand, (n + 1) / 2 intervals
after its support begins.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

__all__ = ["DEGREE", "control_times", "spline_at"]

Array = NDArray[np.float64]

DEGREE = 5
CHUNK = 100_000


def control_times(duration: float, spacing: float) -> Array:
    """Return where the control points of a spline over [0, duration] stand."""
    count = int(duration / spacing) + 1 + DEGREE
    times: Array = spacing * (np.arange(count, dtype=np.float64) - (DEGREE - 1) / 2)
    return times


def spline_at(control: Array, spacing: float, times: Array, derivative: int = 0) -> Array:
    """Return the spline, or a derivative by time, at times within its duration.

    Args:
        control: (m, d) control points, at :func:`control_times`.
        spacing: seconds between knots.
        times: (n,) seconds.
        derivative: how often to differentiate.

    Returns:
        (n, d).
    """
    weights = _basis(DEGREE)[::-1]  # of the control points in their order
    coefficients = np.array(
        [polynomial.polyder(row, derivative) / spacing**derivative for row in weights]
    )
    result = np.empty((len(times), control.shape[1]))
    for begin in range(0, len(times), CHUNK):
        part = slice(begin, begin + CHUNK)
        place = times[part] / spacing
        knot = np.clip(np.floor(place), 0, len(control) - DEGREE - 1).astype(np.int64)
        shares = polynomial.polyval(place - knot, coefficients.T)  # (DEGREE + 1, chunk)
        total = np.zeros((len(place), control.shape[1]))
        for i in range(DEGREE + 1):
            total += shares[i][:, None] * control[knot + i]
        result[part] = total
    return result


def _basis(degree: int) -> Array:
    """Return (degree + 1, degree + 1): row k the coefficients of q_k, the constant first."""
    pieces = np.ones((1, 1))
    for n in range(1, degree + 1):
        raised = np.zeros((n + 1, n + 1))
        for k in range(n):
            raised[k] += polynomial.polymul(pieces[k], [k, 1.0]) / n
            raised[k + 1] += polynomial.polymul(pieces[k], [n - k, -1.0]) / n
        pieces = raised
    return pieces
