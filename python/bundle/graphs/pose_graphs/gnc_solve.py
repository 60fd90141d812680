"""Truncated least squares over poses: GNC from several starts; the smallest cost wins.

Graduated non-convexity (GNC) decides which edges are inliers and which are outliers. The truncated
loss min(x, c^2), x = ||r||^2, is x for an inlier and a constant for an outlier. It has so many
local minima that a solve ends close to its start. Yang, Antonante, Tzoumas and Carlone ("Graduated
non-convexity for robust spatial perception", 2020) minimise

    sum_e  w_e x_e + mu (1 - w_e) / (mu + w_e) c^2

over poses and weights in turn, from mu near 0, where it is convex, to mu -> infinity, where it is
the truncated loss. For given residuals the optimal weights are

    w = 1                              where x <= mu / (mu + 1) c^2,
    w = 0                              where x >= (mu + 1) / mu c^2,
    w = c sqrt(mu (mu + 1) / x) - mu   in between.

c^2 is the 99.95 % quantile of chi2 with the degrees of freedom of an edge, multiplied by the square
of the requested scale: one correct edge in 2000 is classified as an outlier.

GNC starts where the truncated loss is convex for the largest error. Errors after a solve with all
edges do not reveal this largest error: wrong closures deform weak odometry, so that their own
errors are small. The largest errors are those of closures at the poses of the trusted edges alone
(if these connect all poses; otherwise at the start). From these poses, the weights are graduated
twice: once with first weights from these errors, and once with first weights from a solve with all
edges.

If the solve with all edges gives no reason for doubt, all edges are inliers. Otherwise a third set
starts with the trusted edges alone, and the caller may propose more sets. All sets are improved by
moving single edges in or out (``truncated_search``). The set with the smallest truncated cost wins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import freeze
from bundle.base.tails import ONE_IN_2000
from bundle.graphs.pose_graphs.truncated_search import Settled, TruncatedSearch
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.solve_record import Progress
from bundle.model.pose_graph_arrays import PoseGraph

GROWTH = 1.4  # factor of mu from one solve to the next, as in the paper

MOST_SOLVES = 100
NEARLY = 1e-3  # weights this close to 0 or 1 count as 0 or 1


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

    ``chi2``: (m,) squared errors that give the first weights. ``doubted``: (m,) True for edges that
    may be outliers. ``solve``: function from weights (m,) to chi2 (m,) at the poses of a solve with
    these weights, from which the next one starts. ``largest``: largest chi2 for which the loss is
    convex at first; by default that of ``chi2``.

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


Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Proposal = tuple[Flags, Floats]
"""Mask of the inlier edges, and poses."""

HOPELESS = 2.0  # multiple of the smallest cost above which a set is not improved further


class _Interrupted(Exception):  # noqa: N818  (control flow, not an error)
    """Solve interrupted by the user."""


class _Solves:
    """Solves of one graph with edge weights, and the output of the last one."""

    def __init__(
        self,
        graph: PoseGraph,
        held: Flags,
        options: PoseGraphOptions,
        progress: Progress | None,
    ) -> None:
        self.graph, self.held, self.progress = graph, held, progress
        self.plain = options.replace(loss="trivial", loss_scale=1.0, loss_on="closures")
        self.rough = self.plain.replace(function_tolerance=max(self.plain.function_tolerance, 1e-6))
        self.output: dict[str, Any] = {}

    def solve(self, weights: Floats, poses: Floats) -> tuple[Floats, Floats]:
        return self._run(weights, poses, self.rough)

    def finish(self, weights: Floats, poses: Floats) -> None:
        self._run(weights, poses, self.plain)

    def _run(
        self, weights: Floats, poses: Floats, options: PoseGraphOptions
    ) -> tuple[Floats, Floats]:
        weighed = self.graph.replace(
            poses=poses, information=weights[:, None, None] * self.graph.information
        )
        none = np.zeros(self.graph.num_edges, bool)
        self.output = _core.solve_pose_graph(
            weighed, self.held, none, options.asdict(), self.progress
        )
        if self.output["summary"]["interrupted"]:
            raise _Interrupted
        poses = self.output["poses"]
        return poses, _core.edge_chi2(self.graph, options.error, poses)


def solve_gnc(
    graph: PoseGraph,
    held: Flags,
    doubted: Flags,
    options: PoseGraphOptions,
    progress: Progress | None,
    proposals: Iterable[Proposal] = (),
) -> dict[str, Any]:
    """Solve with graduated weights, then once more with weights of 0 or 1.

    ``graph``: graph with the information for the solve, at the poses of the start. ``held``: (n,)
    constant poses. ``doubted``: (m,) edges that may be outliers. ``options``: options with loss
    "gnc_tls".

    Returns:
        Output of the last solve, with chi2, weights and costs of the truncated loss.
    """
    c_squared = options.loss_scale**2 * ONE_IN_2000[graph.tangent_size]
    before = _core.edge_chi2(graph, options.error)
    solves = _Solves(graph, held, options, progress)
    search = TruncatedSearch(
        graph, options.error, doubted, c_squared, solves.solve, options.num_threads or 1
    )
    weights = np.ones(graph.num_edges)
    try:
        best = _best_set(search, solves, held, proposals)
        weights = best.used.astype(float)
        solves.finish(weights, best.poses)
    except _Interrupted:
        pass
    after = _core.edge_chi2(graph, options.error, solves.output["poses"])
    costs = {"initial_cost": search.cost(before) / 2, "final_cost": search.cost(after) / 2}
    return solves.output | {
        "chi2_before": freeze(before.copy()),
        "chi2_after": freeze(after.copy()),
        "weights": freeze(weights),
        "summary": solves.output["summary"] | costs,
    }


def _best_set(
    search: TruncatedSearch, solves: _Solves, held: Flags, proposals: Iterable[Proposal]
) -> Settled:
    graph, doubted = search.graph, search.doubted
    every = solves.solve(np.ones(graph.num_edges), graph.poses)
    if not search.doubt(*every):
        return search.settle(np.ones(graph.num_edges, bool), every[0])
    start, before = graph.poses, _core.edge_chi2(graph, search.error)
    found = []
    if _joins_all(graph, held, ~doubted):
        start, before = solves.solve((~doubted).astype(float), start)
        found.append(search.settle(~doubted, start))
    largest = float(before[doubted].max(initial=0.0))
    for poses, chi2 in ((start, before), every):
        found.append(_graduated(search, solves, poses, chi2, largest))
    found += [search.settle(used | ~doubted, poses) for used, poses in proposals]
    found.sort(key=lambda state: state.cost)
    best = search.improve(found[0])
    for k, state in enumerate(found[1:], 1):
        is_new = all((state.used != other.used).any() for other in found[:k])
        if is_new and state.cost < HOPELESS * found[0].cost:
            best = min(best, search.improve(state), key=lambda one: one.cost)
    return best


def _graduated(
    search: TruncatedSearch, solves: _Solves, poses: Floats, chi2: Floats, largest: float
) -> Settled:
    """Return the final set of graduated weights, started from these errors and poses."""

    def solve(weights: Floats) -> Floats:
        nonlocal poses, chi2
        poses, chi2 = solves.solve(weights, poses)
        return chi2

    weights, _ = graduate(chi2, search.doubted, search.c_squared, solve, largest)
    return search.settle(weights > 0.5, poses)


def _joins_all(graph: PoseGraph, held: Flags, trusted: Flags) -> bool:
    """Return True if trusted edges alone connect every pose to a constant one."""
    root = np.asarray(_core.pose_components(graph.num_poses, graph.edges[trusted]))
    return bool(np.isin(root, root[held]).all())
