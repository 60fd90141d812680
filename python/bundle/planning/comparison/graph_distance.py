"""Distance between two solutions of a pose graph in sigmas of their covariance.

Let X_a and X_b be two solutions with the same constant poses, and Lambda = J^T W J the information
of all edges at X_b, with the weights W of the loss. With the covariance C = sigma0^2 Lambda^-1 the
distance of the tangent coordinates d, X_a = X_b Exp(d), is

    d^T C^-1 d = sum w ||log((X_b,i^-1 X_b,j)^-1 (X_a,i^-1 X_a,j))||^2_Omega / sigma0^2

to first order: J d is the change of the relative poses, in sigmas of the edges. It is the chi2 of a
graph whose edges measure the relative poses of X_b, and bounds every pose and every combination of
poses by that many sigmas, as for reconstructions (``solution_distance``).
"""

from __future__ import annotations

import math

import bundle._core as _core
from bundle.graphs.pose_graphs.information import checked_information
from bundle.graphs.pose_graphs.lie_groups import compose, inverse
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult

LEAST_SIGMA0 = 1e-3
"""Least sigma0. Data without noise would make rounding errors many sigmas."""


def graph_distance(one: PoseGraphResult, best: PoseGraphResult) -> float:
    """Return the distance of two solutions in sigmas; ``best`` has the lower cost."""
    graph = checked_information(best.problem, best.options.information)
    first, second = graph.edges.T
    poses = graph.poses
    between = compose(inverse(poses[first]), poses[second])
    there = graph.replace(measurements=between, poses=one.problem.poses)
    apart = float(best.weights @ _core.edge_chi2(there, "log"))
    freedom = graph.tangent_size * (graph.num_edges - graph.num_poses + graph.num_components)
    variance = float(best.weights @ best.chi2_after) / max(freedom, 1)
    return math.sqrt(apart) / max(math.sqrt(variance), LEAST_SIGMA0)
