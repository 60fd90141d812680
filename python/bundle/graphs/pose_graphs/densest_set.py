"""Bound on the largest clique of a graph, from its degrees.

A clique of d vertices gives each of them d - 1 neighbours. The largest d for which d vertices have
d - 1 neighbours or more is therefore not smaller than the largest clique. Odometry with closures
has about 4, and a few more closures do not change it. A prior that marginalisation left on d
variables raises it to d: the number tells a dense prior from more measurements.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def densest_set(edges: NDArray[np.integer]) -> int:
    """Return the largest d for which d vertices have d - 1 neighbours or more.

    Args:
        edges: (m, 2) pairs of vertices; repeated and reversed pairs count once.
    """
    pairs = np.unique(np.sort(edges.astype(np.int64), axis=1), axis=0).reshape(-1, 2)
    degrees = np.sort(np.bincount(pairs.ravel()))[::-1]
    fits = degrees >= np.arange(len(degrees))
    return int(fits.sum()) if len(pairs) else 0
