"""Seconds per unit of work, from the times of solves whose counts of work differ.

With the counts a_ij of solve i and its time t_i, the rates x minimise the squares of the relative
errors, sum_i (sum_j a_ij x_j / t_i - 1)^2, under the condition that no rate is negative: a time
that the solves cannot tell from others becomes 0, instead of the difference of two large ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def fit_rates(rows: Floats, times: Floats) -> Floats:
    """Return the nonnegative times per feature with the least squares of the relative errors.

    Cyclic coordinate descent: each time in turn takes its best value, at least 0, with all others
    unchanged.
    """
    relative = rows / times[:, None]
    scale = np.linalg.norm(relative, axis=0)
    used = scale > 0
    matrix = relative[:, used] / scale[used]
    found = np.zeros(matrix.shape[1])
    residual = np.ones(len(times))
    for _ in range(20_000):
        change = 0.0
        for k in range(len(found)):
            new = max(0.0, found[k] + float(matrix[:, k] @ residual))
            residual -= (new - found[k]) * matrix[:, k]
            change = max(change, abs(new - found[k]))
            found[k] = new
        if change < 1e-10:
            break
    result = np.zeros(rows.shape[1])
    result[used] = found / scale[used]
    return result
