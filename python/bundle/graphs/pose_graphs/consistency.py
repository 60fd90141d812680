"""Closures that agree with each other along the odometry: the largest pairwise consistent set.

After Mangelson, Dominic, Eustice and Vasudevan, "Pairwise consistent measurement set maximization
for robust multi-robot map merging" (ICRA 2018). Two closures a: i -> j and b: k -> l make a loop
with the odometry O between their ends, i -a-> j, odometry to l, back along b to k, odometry to i.
Seen from the frame of the chain (the inverse of the loop, conjugated by O_j) it is

    D = A^-1 B,     A = O_i Z_a O_j^-1,     B = O_k Z_b O_l^-1,

one motion A for each closure: by how much it says that odometry is wrong. Closures agree where
D = I but for noise. To first order at D = I, with errors on the right of the measurements and
w_t of ``odometry_chain``, Log(D) is the sum of

    Ad(O_l) e_b - Ad(O_j) e_a                               of the closures,
    (([t <= k] - [t <= i]) P + ([t <= j] - [t <= l])) w_t,  P = Ad(B^-1), of odometry step t.

where A may stand for B in P: at D = I they are equal, and of the two covariances the one with
the larger chi2 counts, so that a wrong closure far away does not excuse itself by its own lever.
The first bracket is s on the steps between i and k, the second r on those between l and j, with
signs s, r = +1, -1 by direction. Where these stretches overlap, the same step counts in both, and
the sum is s P + r I, almost nothing where B is near I. With W from ``odometry_chain``

    Cov = S_a + S_b + P W_first P^T + W_second + (P + s r I) W_both (P + s r I)^T,

S_b = Ad(O_l) Sigma_b Ad(O_l)^T, W_first of the steps of the first stretch alone, and so on. The
pair is consistent where Log(D)^T Cov^-1 Log(D) is below the quantile of chi2 that one right pair in
a million exceeds: of 2000 right closures, two million pairs, a stricter one would lose many.

Closures of one odometry form one set: right closures at different places agree with each other
within the noise between them, so the largest set holds all places. A file of several trajectories
has gaps in its odometry and is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.errors import InputError
from bundle.graphs.pose_graphs.chi2_quantiles import ONE_IN_A_MILLION
from bundle.graphs.pose_graphs.largest_set import largest_set
from bundle.graphs.pose_graphs.lie_groups import adjoints, compose, inverse, logarithm
from bundle.graphs.pose_graphs.odometry_chain import OdometryChain, edge_covariance, odometry_chain
from bundle.model.pose_graph_arrays import PoseGraph

__all__ = [
    "ClosureConsistency",
    "LeftOutEdge",
    "closure_consistency",
    "pair_chi2",
]

PAIRS_AT_ONCE = 20_000

MOST_CLOSURES = 10_000
"""50 million pairs: minutes, and 2 GB."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class LeftOutEdge:
    """A closure outside the largest consistent set.

    Attributes:
        edge: its position in the graph.
        chi2: its largest one of a pair with a closure of the set; chi2 with 3 or 6 degrees of
            freedom where both are right.
        num_contradicted: closures of the set with which it is inconsistent.
    """

    edge: int
    chi2: float
    num_contradicted: int


@dataclass(frozen=True, kw_only=True)
class ClosureConsistency:
    """What the pairwise check found.

    Attributes:
        left_out: closures outside the set, the largest chi2 first.
        num_closures: in all.
        proven: False where a larger set may exist, as time ran out.
    """

    left_out: tuple[LeftOutEdge, ...]
    num_closures: int
    proven: bool


def closure_consistency(graph: PoseGraph, num_threads: int = 1) -> ClosureConsistency:
    """Find the largest set of closures that are consistent with each other, pair by pair.

    Args:
        graph: its odometry (edges between consecutive ids) without gaps; closures are all others.
        num_threads: for composing the odometry.

    Raises:
        InputError: odometry has a gap; the information of an edge is singular; there are more than
            10,000 closures; SciPy is missing.
    """
    closures = np.flatnonzero(graph.is_closure)
    if len(closures) > MOST_CLOSURES:
        raise InputError(
            f"consistency: expected at most {MOST_CLOSURES} closures, found {len(closures)}"
        )
    chi2 = pair_chi2(graph, closures, odometry_chain(graph, num_threads))
    conflicts = ~(chi2 <= ONE_IN_A_MILLION[graph.tangent_size])  # what is not finite contradicts
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
                    "consistency: expected information whose covariances along the odometry "
                    "can be inverted, found a singular one"
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
    """Return the part of Cov that is odometry's, of stretches from place to place."""
    low, high = np.minimum(*to_start), np.maximum(*to_start)
    low_end, high_end = np.minimum(*to_end), np.maximum(*to_end)
    below = np.maximum(low, low_end)
    above = np.maximum(np.minimum(high, high_end), below)  # empty where they do not overlap
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
