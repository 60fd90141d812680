"""Walks whose odometry is weak and whose closures are few: a wrong one can hide its error."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

import bundle
from bundle import _core
from bundle.base.tails import ONE_IN_2000
from tests.graphs.pose_graphs.graphs import matrix, pose_of


def _random_pose(rng, dimension, place, angle):
    if dimension == 2:
        return matrix(np.append(rng.normal(0, place, 2), rng.normal(0, angle)))
    turn = Rotation.from_rotvec(rng.normal(0, angle, 3)).as_quat()
    return matrix(np.append(turn, rng.normal(0, place, 3)))


def weak_walk(dimension, seed, *, num_wrong=1, agreeing=False, num_right=3, num_poses=50):
    """A walk from odometry with sigma 0.5 (m) and 0.3 (rad); wrong closures come last."""
    rng = np.random.default_rng(seed)
    sigma, angle = 0.5, 0.3
    truth = [np.eye(dimension + 1)]
    for _ in range(num_poses - 1):
        truth.append(truth[-1] @ _random_pose(rng, dimension, 1.0, 0.4))

    def measured(i, j):
        return np.linalg.inv(truth[i]) @ truth[j] @ _random_pose(rng, dimension, sigma, angle)

    edges = [(k, k + 1) for k in range(num_poses - 1)]
    values = [measured(*edge) for edge in edges]
    while len(edges) < num_poses - 1 + num_right:
        i, j = sorted(rng.choice(num_poses, 2, replace=False).tolist())
        if j - i > 2:
            edges.append((i, j))
            values.append(measured(i, j))
    i, j = sorted(rng.choice(num_poses - 3, 2, replace=False).tolist())
    j = max(j, i + 3)
    off = _random_pose(rng, dimension, 8.0, 1.5)
    for k in range(num_wrong):
        if not agreeing:
            i, j = sorted(rng.choice(num_poses, 2, replace=False).tolist())
            j += j == i + 1 and j + 1 < num_poses
            i -= j == i + 1
            off = _random_pose(rng, dimension, 8.0, 1.5)
        edges.append((i, j + k % 3 if agreeing else j))
        first, second = edges[-1]
        moved = np.linalg.inv(truth[j]) @ truth[second] if agreeing else np.eye(dimension + 1)
        values.append(np.linalg.inv(truth[first]) @ truth[j] @ off @ moved)
    start = [np.eye(dimension + 1)]
    for value in values[: num_poses - 1]:
        start.append(start[-1] @ value)
    weights = [sigma**-2, sigma**-2, angle**-2] if dimension == 2 else [angle**-2] * 3
    weights = weights if dimension == 2 else [*weights, *[sigma**-2] * 3]
    return bundle.PoseGraph(
        poses=np.array([pose_of(pose) for pose in start]),
        edges=np.array(edges),
        measurements=np.array([pose_of(value) for value in values]),
        information=np.tile(np.diag(weights), (len(edges), 1, 1)),
    )


def truncated(graph, poses):
    """Chi2 of odometry, and of closures up to the quantile."""
    chi2 = np.asarray(_core.edge_chi2(graph.replace(poses=poses), "log"))
    bounded = np.minimum(chi2, ONE_IN_2000[graph.tangent_size])
    return float(np.where(graph.is_closure, bounded, chi2).sum())


def least_truncated(graph):
    """The least truncated cost over solves with every set of closures."""
    closures = np.flatnonzero(graph.is_closure)
    costs = []
    for bits in itertools.product([False, True], repeat=len(closures)):
        used = np.ones(graph.num_edges, bool)
        used[closures] = bits
        kept = graph.replace(
            edges=graph.edges[used],
            measurements=graph.measurements[used],
            information=graph.information[used],
            edge_lines=graph.edge_lines[used],
        )
        solved = bundle.solve(kept, max_num_iterations=300, num_threads=1)
        costs.append(truncated(graph, solved.problem.poses))
    return min(costs)
