"""Largest set of closures that are pairwise consistent along the odometry.

After Mangelson, Dominic, Eustice and Vasudevan, "Pairwise consistent measurement set maximization
for robust multi-robot map merging" (ICRA 2018). Two closures a: i -> j and b: k -> l form a loop
with the odometry O between their ends: i -a-> j, odometry to l, back along b to k, odometry to i.
In the frame of the chain (the inverse of the loop, conjugated by O_j) it is

    D = A^-1 B,     A = O_i Z_a O_j^-1,     B = O_k Z_b O_l^-1,

with one motion A per closure: the correction of the odometry that it measures. Consistent closures
have D = I up to noise. To first order at D = I, with errors on the right of the measurements and
w_t as below, Log(D) is the sum of

    Ad(O_l) e_b - Ad(O_j) e_a                               of the closures,
    (([t <= k] - [t <= i]) P + ([t <= j] - [t <= l])) w_t,  P = Ad(B^-1), of odometry step t.

where A may replace B in P, because they are equal at D = I. This gives two covariances. The larger
chi2 of both is used, so that the long lever of a wrong closure far away does not inflate its
covariance. The first bracket is s on the steps between i and k, the second is r on the steps
between l and j, with signs s, r = +1, -1 by direction. If these stretches overlap, a step counts in
both, and the sum is s P + r I, which is nearly zero if B is near I. With W as below

    Cov = S_a + S_b + P W_first P^T + W_second + (P + s r I) W_both (P + s r I)^T,

where S_b = Ad(O_l) Sigma_b Ad(O_l)^T, and W_first is the sum over steps in the first stretch only.
The pair is consistent if Log(D)^T Cov^-1 Log(D) is below the quantile of chi2 that one correct pair
in a million exceeds. 2000 correct closures have two million pairs, of which a stricter quantile
would reject many.

The correct closures of one odometry form one set: closures at different places agree within the
noise between them, so that the largest set covers all places. A file with several trajectories has
gaps in its odometry and is refused.

Odometry chain. Pose q of the chain is O_q = O_{q-1} Z_q. Each measurement has an error on its
right, Z_t Exp(e_t) with e_t ~ N(0, Sigma_t), Sigma_t the inverse of its information. Because X
Exp(d) = Exp(Ad_X d) X, an error of step t moves all later poses together as one rigid body, by w_t
in the frame of the chain:

    O_q -> Exp(w_t) O_q  for q >= t,     w_t = Ad(O_t) e_t.

Steps are independent, so that covariances of w add up. The sum over the steps between p and q is

    sum_{p < t <= q} Cov(w_t) = W_q - W_p,     W_q = sum_{t <= q} Ad(O_t) Sigma_t Ad(O_t)^T,

a difference of two prefix sums that needs no second pass over the chain. An edge against the
direction of the chain measures the inverse: Z^-1 Exp(e) with e of covariance Ad(Z) Sigma Ad(Z)^T.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import freeze
from bundle.base.optional_packages import require_package
from bundle.base.records import dataclass
from bundle.base.tails import ONE_IN_A_MILLION
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.graphs.pose_graphs.edge_weights import checked_information, with_edges
from bundle.graphs.pose_graphs.lie_groups import adjoints, compose, inverse, logarithm
from bundle.graphs.pose_graphs.pose_graph_result import LeftOutEdge, PoseGraphResult
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.model.pose_graph_arrays import PoseGraph

PAIRS_AT_ONCE = 20_000

MOST_CLOSURES = 10_000  # largest number of closures: 50 million pairs take minutes and 2 GB

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ClosureConsistency:
    """Result of the pairwise check."""

    left_out: tuple[LeftOutEdge, ...]  # closures outside the set, by descending chi2
    num_closures: int  # number of all closures
    proven: bool  # False if the time limit was reached and a larger set may exist


def closure_consistency(graph: PoseGraph, num_threads: int = 1) -> ClosureConsistency:
    """Find the largest set of pairwise consistent closures of a graph with complete odometry."""
    closures = np.flatnonzero(graph.is_closure)
    if len(closures) > MOST_CLOSURES:
        raise InputError(
            f"consistency: expected at most {MOST_CLOSURES} closures, found {len(closures)}"
        )
    chi2 = pair_chi2(graph, closures, odometry_chain(graph, num_threads))
    # values that are not finite count as conflicts
    conflicts = ~(chi2 <= ONE_IN_A_MILLION[graph.tangent_size])
    kept, proven = largest_set(conflicts)
    out = np.flatnonzero(~kept)
    worst = chi2[np.ix_(out, kept)].max(axis=1, initial=0.0)
    contradicted = conflicts[np.ix_(out, kept)].sum(axis=1)
    left_out = tuple(
        LeftOutEdge(
            edge=int(closures[out[k]]), chi2=float(worst[k]), num_contradicted=int(contradicted[k])
        )
        for k in np.argsort(-worst, kind="stable")
    )
    return ClosureConsistency(left_out=left_out, num_closures=len(closures), proven=proven)


def pair_chi2(graph: PoseGraph, closures: NDArray[np.intp], chain: OdometryChain) -> Floats:
    """Return Log(D)^T Cov^-1 Log(D) of each pair of closures: (k, k) symmetric, zero diagonal."""
    first, second = graph.edges[closures].T
    poses = chain.poses
    claims = compose(compose(poses[first], graph.measurements[closures]), inverse(poses[second]))
    claims_back = inverse(claims)
    back = adjoints(claims_back)
    moved = adjoints(poses[second])
    noise = moved @ edge_covariance(graph, closures) @ moved.transpose(0, 2, 1)
    starts, ends = chain.place[first], chain.place[second]
    count = len(closures)
    chi2 = np.zeros((count, count))
    upper_a, upper_b = np.triu_indices(count, 1)
    for begin in range(0, len(upper_a), PAIRS_AT_ONCE):
        a = upper_a[begin : begin + PAIRS_AT_ONCE]
        b = upper_b[begin : begin + PAIRS_AT_ONCE]
        apart = logarithm(compose(claims_back[a], claims[b]))
        for turned in (back[a], back[b]):
            covariance = noise[a] + noise[b]
            covariance += _odometry_noise(
                chain.accumulated, turned, (starts[a], starts[b]), (ends[b], ends[a])
            )
            try:
                solved = np.linalg.solve(covariance, apart[:, :, None])[:, :, 0]
            except np.linalg.LinAlgError:
                raise InputError(
                    "consistency: expected invertible covariances along the odometry, found a "
                    "singular covariance"
                ) from None
            chi2[a, b] = np.maximum(chi2[a, b], np.einsum("nc,nc->n", apart, solved))
        chi2[b, a] = chi2[a, b]
    return chi2


def _odometry_noise(
    accumulated: Floats,
    turned: Floats,
    to_start: tuple[NDArray[np.intp], NDArray[np.intp]],
    to_end: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> Floats:
    """Return the contribution of odometry to Cov, over stretches from place to place."""
    low, high = np.minimum(*to_start), np.maximum(*to_start)
    low_end, high_end = np.minimum(*to_end), np.maximum(*to_end)
    below = np.maximum(low, low_end)
    above = np.maximum(np.minimum(high, high_end), below)  # empty if they do not overlap
    both = accumulated[above] - accumulated[below]
    start_alone = accumulated[high] - accumulated[low] - both
    end_alone = accumulated[high_end] - accumulated[low_end] - both
    same = np.sign(to_start[1] - to_start[0]) * np.sign(to_end[1] - to_end[0])
    twice = turned + same[:, None, None] * np.eye(turned.shape[1])
    total: Floats = (
        turned @ start_alone @ turned.transpose(0, 2, 1)
        + end_alone
        + twice @ both @ twice.transpose(0, 2, 1)
    )
    return total


UNPROVEN_SET = "unproven_set"
MOST_LEFT_OUT = "most_left_out"

Solve = Callable[[PoseGraph, PoseGraphOptions], tuple[PoseGraphResult, Floats]]


def solve_consistent(graph: PoseGraph, options: PoseGraphOptions, solve: Solve) -> PoseGraphResult:
    """Solve without the closures outside the largest consistent set; report on all edges."""
    begun = perf_counter()
    weighed = checked_information(graph, options.information)
    found = closure_consistency(weighed, options.num_threads or 1)
    kept = np.ones(graph.num_edges, bool)
    kept[[entry.edge for entry in found.left_out]] = False
    edges = np.flatnonzero(kept)
    check_time = perf_counter() - begun
    solved, start = solve(with_edges(graph, edges), options.replace(consistency=False))
    after = _core.edge_chi2(weighed, options.error, solved.problem.poses).copy()
    before = _core.edge_chi2(weighed, options.error, start).copy()
    after[edges], before[edges] = solved.chi2_after, solved.chi2_before
    weights = np.zeros(graph.num_edges)
    weights[edges] = solved.weights
    said = _warnings(found)
    return dataclasses.replace(
        solved,
        problem=graph.replace(poses=solved.problem.poses, has_poses=True),
        initial_problem=graph,
        options=options.replace(num_threads=solved.options.num_threads),
        chi2_before=freeze(before),
        chi2_after=freeze(after),
        weights=freeze(weights),
        rejected=tuple(int(edges[edge]) for edge in solved.rejected),
        left_out=found.left_out,
        build_time_in_seconds=solved.build_time_in_seconds + check_time,
        summary=dataclasses.replace(
            solved.summary,
            num_left_out_edges=len(found.left_out),
            warnings=(*solved.summary.warnings, *said.values()),
            warning_kinds=(*solved.summary.warning_kinds, *said),
        ),
    )


def _warnings(found: ClosureConsistency) -> dict[str, str]:
    said = {}
    if not found.proven:
        said[UNPROVEN_SET] = (
            "The search for the largest consistent set of closures reached its time limit: "
            "the best set found is used, and a larger one may exist."
        )
    if 2 * len(found.left_out) >= found.num_closures > 1:
        said[MOST_LEFT_OUT] = (
            f"{plural(len(found.left_out), 'closure')} of {found.num_closures} contradict "
            "the largest consistent set and are left out. This is half of them or more: the set "
            "may be the wrong one."
        )
    return said


SINGULAR = 1e-14
"""Smallest eigenvalue of information with a unit diagonal that counts as invertible."""


@dataclass(frozen=True, kw_only=True)
class OdometryChain:
    """Odometry of a graph, relative to the centre of its poses."""

    poses: Floats  # (n, 3) or (n, 7) in the order of the graph's poses
    place: NDArray[np.intp]  # (n,) place of each pose along the chain, from 0
    accumulated: Floats  # (n, d, d) matrices W by place; zero at the first place


def odometry_chain(graph: PoseGraph, num_threads: int) -> OdometryChain:
    """Compose the odometry chain from the first edge between each two successive poses."""
    order = np.argsort(graph.ids, kind="stable")
    first, second = _core.odometry_gap(graph)
    if first >= 0:
        raise InputError(
            "consistency: expected odometry without gaps, found no edge between "
            f"{graph.ids[first]} and {graph.ids[second]}"
        )
    held = np.zeros(graph.num_poses, bool)
    held[order[0]] = True
    poses = np.array(_core.initial_poses(graph, held, "odometry", num_threads))
    position = slice(0, 2) if graph.dimension == 2 else slice(4, 7)
    poses[:, position] -= poses[:, position].mean(axis=0)  # short levers lose fewer digits
    place = np.empty(graph.num_poses, np.intp)
    place[order] = np.arange(graph.num_poses)

    ends = place[graph.edges]
    steps = np.flatnonzero(~graph.is_closure)
    later, which = np.unique(ends[steps].max(axis=1), return_index=True)  # first edge of each step
    steps = steps[which]
    covariance = edge_covariance(graph, steps)
    back = ends[steps, 0] > ends[steps, 1]
    # Relative to the later end of the edge, then in the chain's frame.
    turned = adjoints(graph.measurements[steps[back]])
    covariance[back] = turned @ covariance[back] @ turned.transpose(0, 2, 1)
    moved = adjoints(poses[order[later]])
    d = graph.tangent_size
    accumulated = np.zeros((graph.num_poses, d, d))
    accumulated[1:] = np.cumsum(moved @ covariance @ moved.transpose(0, 2, 1), axis=0)
    return OdometryChain(poses=poses, place=place, accumulated=accumulated)


def edge_covariance(graph: PoseGraph, edges: NDArray[np.intp]) -> Floats:
    """Return the covariances (k, d, d) of some edges in tangent coordinates."""
    information = graph.information[edges]
    information[~np.isfinite(information).all(axis=(1, 2))] = 0.0
    diagonal = np.diagonal(information, axis1=1, axis2=2)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1))
    scaled = scale[:, :, None] * information * scale[:, None, :]
    singular = np.linalg.eigvalsh(scaled)[:, 0] < SINGULAR
    if singular.any():
        name = graph.edge_name(int(edges[np.argmax(singular)]))
        raise InputError(
            f"consistency: {name}: expected invertible information, found a singular matrix "
            "or infinity"
        )
    inverse: Floats = scale[:, :, None] * np.linalg.inv(scaled) * scale[:, None, :]
    return inverse


# Largest independent set of vertices (largest clique of the complement).
#
# The integer programme is max sum x, x_u + x_v <= 1 for each edge, x in {0, 1}. Its relaxation to 0
# <= x <= 1 has corners in {0, 1/2, 1}. There is a largest set that contains every vertex of value 1
# and no vertex of value 0 (Nemhauser and Trotter, "Vertex packings: structural properties and
# algorithms", 1975). The relaxation is a matching in a bipartite graph. This graph has each vertex
# twice, u on the left and u' on the right, with edges u-v' and v-u'. Koenig's theorem gives a
# smallest vertex cover of this graph, and x_u is 1 minus half the number of copies of u in the
# cover. HiGHS decides the vertices of value 1/2, which are rare.
#
# Correct closures have few edges between each other and many edges to wrong closures. Therefore the
# relaxation usually decides all vertices, even thousands. A search for cliques in the dense
# complement would have to enumerate them.

TIME_LIMIT = 30.0  # time limit in seconds for the vertices that the relaxation leaves undecided

Flags = NDArray[np.bool_]


def largest_set(conflicts: Flags) -> tuple[Flags, bool]:
    """Return the largest set of vertices without a conflict, and True if this is proven.

    ``conflicts``: (n, n) symmetric, its diagonal False.

    Returns:
        Mask (n,) of the set; and False if HiGHS reached the time limit, so that a larger set may
        exist.
    """
    require_package("scipy", "scipy", "consistency")
    from scipy import sparse  # optional dependency

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
    """Solve the integer programme; at the time limit, return the larger of it and a greedy set."""
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
