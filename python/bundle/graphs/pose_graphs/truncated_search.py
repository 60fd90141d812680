"""Edge sets of low truncated cost: solve, classify, test single edges; choice of a loss (auto).

Let S be the set of doubted edges that are in use ("in"). The truncated cost is
the minimum, over sets S and poses, of the sum of chi2 over trusted edges and S, plus c^2 for each
doubted edge that is not in S ("out").

*Settling* a set solves with it, puts each edge in or out by its chi2, and repeats: the cost never
rises. A settled set may still contain a wrong closure whose error has shifted to weak edges. The
chi2 of this closure is small, and the chi2 of the edges around it is large. Covariances predict the
decrease of the sum without this closure. Let A be the whitened Jacobian of an edge with respect to
the relative pose that it measures, C_ij the covariance of this pose and r the whitened error. To
first order

    an edge that is in   lowers the sum by  r^T K^+ r,   K = I - A C_ij A^T,   if it is taken out;
    an edge that is out  raises the sum by  r^T P^-1 r,  P = I + A C_ij A^T,   if it is put in

(the first is Baarda's test, ``graph_covariance.cpp``). An edge with a test value above c^2 should
be out. An edge whose cost of inclusion r^T P^-1 r is below c^2 should be in. *Improving* tries such
edges, the largest gain first, settles each resulting set, and keeps the set if its truncated cost
is lower.

The loss ``auto`` tries losses for wrong closures and compares them. None of the losses finds every
set of wrong closures: dynamic covariance scaling (DCS) ends in local minima that graduated
non-convexity (GNC) avoids, and vice versa. Both search for poses with which most closures agree.
The truncated cost measures this agreement independently of the loss:

    1/2 sum over trusted edges x + 1/2 sum over doubted edges min(x, c^2),    x = r^T Omega r,

with c^2 the 99.95 % quantile of chi2 multiplied by the square of the scale. A solve without a loss
comes first. It is kept if it gives no reason for doubt: every closure is below c^2, chi2 does not
exceed its degrees of freedom, and no closure has shifted its error to other edges.
Otherwise the solution with the smallest truncated cost is used. GNC also
tries the set of closures that DCS keeps, and the largest set of consistent closures
(``consistency``).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.base.tails import chi2_quantile
from bundle.base.words import number, plural
from bundle.graphs.pose_graphs.edge_weights import with_edges
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.model.pose_graph_arrays import PoseGraph

MOST_SETTLES = 10
MOST_FLIPS = 20
MOST_TRIES = 4  # number of edges to try in each step of an improvement

LOWER = 1e-6  # relative decrease of the truncated cost below which a set has not improved

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Settled:
    """Set of edges, and the poses of a solve with them."""

    cost: float  # sum of chi2, limited to c^2 for doubted edges (twice the truncated cost)
    poses: Floats  # poses in the format of a graph
    chi2: Floats  # (m,) chi2 of all edges at these poses
    used: Flags  # (m,) True where an edge is in


class TruncatedSearch:
    """Search for sets of low truncated cost.

    Args:
        graph: graph with the information for a solve.
        error: error of its edges.
        doubted: (m,) True for edges that may be out.
        c_squared: price of an edge that is out.
        solve: function from weights (m,) and poses to poses and chi2 (m,) of all edges.
        num_threads: threads for covariances.
    """

    def __init__(
        self,
        graph: PoseGraph,
        error: str,
        doubted: Flags,
        c_squared: float,
        solve: Callable[[Floats, Floats], tuple[Floats, Floats]],
        num_threads: int = 1,
    ) -> None:
        self.graph, self.error, self.doubted = graph, error, doubted
        self.c_squared, self._solve, self._threads = c_squared, solve, num_threads

    def cost(self, chi2: Floats) -> float:
        """Return the sum of chi2, limited to c^2 for doubted edges."""
        return float(np.where(self.doubted, np.minimum(chi2, self.c_squared), chi2).sum())

    def doubt(self, poses: Floats, chi2: Floats) -> str:
        """Return :func:`find_doubt` of a solve with all edges."""
        there = self.graph.replace(poses=poses)
        return find_doubt(there, self.error, self.doubted, chi2, self.c_squared, self._threads)

    def settle(self, used: Flags, poses: Floats) -> Settled:
        """Solve and classify in turn until the set or its cost does not change any more."""
        best: Settled | None = None
        for _ in range(MOST_SETTLES):
            poses, chi2 = self._solve(used.astype(float), poses)
            found = Settled(cost=self.cost(chi2), poses=poses, chi2=chi2, used=used)
            if best is not None and not found.cost < best.cost:
                return best
            best = found
            sorted_ = ~self.doubted | (chi2 <= self.c_squared)
            if (sorted_ == used).all():
                break
            used = sorted_
        assert best is not None
        return best

    def improve(self, state: Settled) -> Settled:
        """Add or remove single edges while the cost decreases."""
        for _ in range(MOST_FLIPS):
            better = self._flipped(state)
            if better is None:
                break
            state = better
        return state

    def _flipped(self, state: Settled) -> Settled | None:
        gains = flip_gains(
            self.graph.replace(poses=state.poses),
            self.error,
            self.doubted,
            state.used,
            self.c_squared,
            self._threads,
        )
        for edge in np.argsort(-gains, kind="stable")[:MOST_TRIES]:
            if not gains[edge] > 0:
                break
            used = state.used.copy()
            used[edge] = not used[edge]
            found = self.settle(used, state.poses)
            if found.cost < (1 - LOWER) * state.cost:
                return found
        return None


def find_doubt(
    graph: PoseGraph,
    error: str,
    doubted: Flags,
    chi2: Floats,
    c_squared: float,
    num_threads: int = 1,
) -> str:
    """Return evidence of wrong edges, in words after "without a loss"; "" without any."""
    beyond = int((doubted & (chi2 > c_squared)).sum())
    if beyond:
        have = "has" if beyond == 1 else "have"
        return f"{plural(beyond, 'edge')} {have} a chi2 above {number(c_squared)}"
    degrees = graph.tangent_size * (graph.num_edges - graph.num_poses + graph.num_components)
    if chi2.sum() > chi2_quantile(degrees):
        return f"chi2 is {number(chi2.sum())} with {plural(degrees, 'degree')} of freedom"
    every = np.ones(graph.num_edges, bool)
    gains = flip_gains(graph, error, doubted, every, c_squared, num_threads)
    masked = int((gains > 0).sum())
    if not masked:
        return ""
    return f"chi2 would fall by more than {number(c_squared)} without {plural(masked, 'edge')}"


def flip_gains(
    graph: PoseGraph,
    error: str,
    doubted: Flags,
    used: Flags,
    c_squared: float,
    num_threads: int = 1,
) -> Floats:
    """Return the first-order decrease of the sum if an edge is flipped; other edges: -inf."""
    gains = np.full(graph.num_edges, -np.inf)
    inside, outside = np.flatnonzero(used), np.flatnonzero(doubted & ~used)
    found = _core.graph_covariance(
        with_edges(graph, inside),
        error,
        inner=False,
        of_edges=True,
        relative=[(int(i), int(j)) for i, j in graph.edges[outside]],
        num_threads=num_threads,
    )
    if found["undetermined_pose"] >= 0:
        return gains
    test = np.asarray(found["edge_test"])
    gains[inside] = np.where(np.isfinite(test), test - c_squared, -np.inf)
    for edge, covariance in zip(outside, found["relative"], strict=True):
        gains[edge] = c_squared - _price(graph, error, int(edge), covariance)
    gains[~doubted] = -np.inf
    return gains


def _price(graph: PoseGraph, error: str, edge: int, covariance: Floats) -> float:
    """Return r^T P^-1 r, as r^T (Omega^-1 + E C E^T)^-1 r without inverting the information."""
    first, second = graph.edges[edge]
    residual, _, jacobian = _core.relative_pose_error(
        error, graph.poses[first], graph.poses[second], graph.measurements[edge]
    )
    information = graph.information[edge]
    spread = np.eye(len(residual)) + jacobian @ covariance @ jacobian.T @ information
    return float(residual @ information @ np.linalg.solve(spread, residual))


TRIED = ("dcs", "gnc_tls")  # losses for wrong closures that ``auto`` tries

Solve = Callable[[PoseGraphOptions], dict[str, Any]]


def truncated_cost(
    chi2: NDArray[np.float64], doubted: NDArray[np.bool_], c_squared: float
) -> float:
    """Return 1/2 sum of chi2, limited to c^2 for doubted edges."""
    return 0.5 * float(np.where(doubted, np.minimum(chi2, c_squared), chi2).sum())


def loss_cost(
    chi2: NDArray[np.float64],
    doubted: NDArray[np.bool_],
    options: PoseGraphOptions,
    c_squared: float,
) -> float:
    """Return 1/2 sum of rho of chi2 (m,), with the loss of the options on doubted edges."""
    if options.loss == "trivial":
        return 0.5 * float(chi2.sum())
    if options.loss == "gnc_tls":
        return truncated_cost(chi2, doubted, c_squared)
    rho = np.array(chi2)
    for edge in np.flatnonzero(doubted).tolist():
        rho[edge] = _core.edge_loss(options.loss, options.loss_scale, float(chi2[edge]))[0]
    return 0.5 * float(rho.sum())


def choose_loss(
    solve: Solve,
    doubted: NDArray[np.bool_],
    options: PoseGraphOptions,
    c_squared: float,
    doubts: Callable[[dict[str, Any]], str],
) -> tuple[PoseGraphOptions, dict[str, Any], str]:
    """Solve without a loss, then with the losses to try if necessary.

    ``solve``: function from options to a solve from a common start; its output has "chi2_after" and
    "summary". ``doubted``: (m,) edges to which the loss applies. ``options``: options with loss
    "auto". ``doubts``: function from the output of the solve without a loss to the reason to doubt
    it, in words that continue the phrase "without a loss"; "" if there is no doubt.

    Returns:
        Options with the chosen loss, the output of its solve, and the reason in a sentence.
    """
    plain = options.replace(loss="trivial", loss_scale=1.0, loss_on="closures")
    output = solve(plain)
    if output["summary"]["interrupted"]:
        return plain, output, "No loss: the run stopped before a loss was tried."
    doubt = doubts(output)
    if not doubt:
        reason = f"No loss: without one, all closures have a chi2 of at most {number(c_squared)}."
        return plain, output, reason
    tried = [(plain, output)]
    for loss in TRIED:
        chosen = options.replace(loss=loss)
        tried.append((chosen, solve(chosen)))
        if tried[-1][1]["summary"]["interrupted"]:
            break
    costs = [truncated_cost(found["chi2_after"], doubted, c_squared) for _, found in tried]
    best = int(np.argmin(costs))
    words = ", ".join(
        f"{number(cost)} by {_name(options)}"
        for cost, (options, _) in zip(costs, tried, strict=True)
    )
    reason = (
        f"{_name(tried[best][0])}: without a loss, {doubt}; its truncated cost is the "
        f"least ({words})."
    )
    return (*tried[best], reason)


def _name(options: PoseGraphOptions) -> str:
    return "no loss" if options.loss == "trivial" else options.loss.replace("_", "-")
