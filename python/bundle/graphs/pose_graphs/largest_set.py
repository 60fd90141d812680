"""Largest independent set of vertices (largest clique of the complement).

The integer programme is max sum x, x_u + x_v <= 1 for each edge, x in {0, 1}. Its relaxation to 0
<= x <= 1 has corners in {0, 1/2, 1}. There is a largest set that contains every vertex of value 1
and no vertex of value 0 (Nemhauser and Trotter, "Vertex packings: structural properties and
algorithms", 1975). The relaxation is a matching in a bipartite graph. This graph has each vertex
twice, u on the left and u' on the right, with edges u-v' and v-u'. Koenig's theorem gives a
smallest vertex cover of this graph, and x_u is 1 minus half the number of copies of u in the cover.
HiGHS decides the vertices of value 1/2, which are rare.

Correct closures have few edges between each other and many edges to wrong closures. Therefore the
relaxation usually decides all vertices, even thousands. A search for cliques in the dense
complement would have to enumerate them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError

TIME_LIMIT = 30.0
"""Time limit in seconds for the vertices that the relaxation leaves undecided."""

Flags = NDArray[np.bool_]


def largest_set(conflicts: Flags) -> tuple[Flags, bool]:
    """Return the largest set of vertices without a conflict, and True if this is proven.

    Args:
        conflicts: (n, n) symmetric, its diagonal False.

    Returns:
        Mask (n,) of the set; and False if HiGHS reached the time limit, so that a larger set may
        exist.
    """
    sparse = _import_scipy()
    chosen: Flags = np.logical_not(conflicts.any(axis=1))
    open_ = np.flatnonzero(~chosen)
    if not len(open_):
        return chosen, True
    left, right = _smallest_cover(sparse.csr_array(conflicts[np.ix_(open_, open_)]))
    chosen[open_[~left & ~right]] = True
    open_ = open_[left ^ right]
    if not len(open_):
        return chosen, True
    found, proven = _by_integers(conflicts[np.ix_(open_, open_)])
    chosen[open_[found]] = True
    return chosen, proven


def _smallest_cover(pattern: Any) -> tuple[Flags, Flags]:
    """Return the copies on the left and on the right of a smallest vertex cover.

    Koenig: from unmatched vertices on the left follow any edge to the right and matched edges back.
    The cover consists of unreached vertices on the left and reached ones on the right.
    """
    from scipy.sparse.csgraph import maximum_bipartite_matching  # optional dependency

    to_right = np.asarray(maximum_bipartite_matching(pattern, perm_type="column"))
    to_left = np.full(len(to_right), -1)
    matched = to_right >= 0
    to_left[to_right[matched]] = np.flatnonzero(matched)
    reached_left, reached_right = ~matched, np.zeros(len(to_right), bool)
    front = np.flatnonzero(reached_left)
    while len(front):
        seen = np.asarray(pattern[front].sum(axis=0)).ravel() > 0
        new = seen & ~reached_right
        reached_right |= new
        front = to_left[new]
        front = front[~reached_left[front]]
        reached_left[front] = True
    return ~reached_left, reached_right


def _by_integers(conflicts: Flags) -> tuple[Flags, bool]:
    """Solve the integer programme.

    At the time limit, return the larger of its best set and a greedy set.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp  # optional dependency
    from scipy.sparse import csr_array  # optional dependency

    n = len(conflicts)
    first, second = np.nonzero(np.triu(conflicts))
    rows = np.tile(np.arange(len(first)), 2)
    pairs = csr_array(
        (np.ones(len(rows)), (rows, np.concatenate([first, second]))), shape=(len(first), n)
    )
    solved = milp(
        -np.ones(n),
        integrality=np.ones(n),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(pairs, -np.inf, 1),
        options={"time_limit": TIME_LIMIT},
    )
    greedy = _greedy(conflicts)
    if solved.x is None:
        return greedy, False
    found: Flags = solved.x > 0.5
    return (found if found.sum() >= greedy.sum() else greedy), solved.status == 0


def _greedy(conflicts: Flags) -> Flags:
    """Repeatedly add the vertex with the fewest conflicts and drop its neighbours."""
    chosen, left = np.zeros(len(conflicts), bool), np.ones(len(conflicts), bool)
    count = conflicts.sum(axis=1)
    while left.any():
        vertex = int(np.argmin(np.where(left, count, len(count) + 1)))
        dropped = left & conflicts[vertex]
        chosen[vertex], left[vertex] = True, False
        left &= ~dropped
        count = count - conflicts[:, dropped].sum(axis=1)
    return chosen


def _import_scipy() -> Any:
    try:
        from scipy import sparse  # optional dependency
    except ImportError:
        raise InputError(
            "consistency: expected the package scipy, which is not installed: pip install scipy"
        ) from None
    return sparse
