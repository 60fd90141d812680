"""Certificates of graphs whose weights differ by many orders of magnitude."""

import numpy as np
import pytest

import bundle
from tests.graphs.pose_graphs.chordal_oracle import join, split
from tests.graphs.pose_graphs.test_certify import _moved, ring


def _with_chain(graph, kappa, tau):
    """Return the graph with two more poses that hang on its first one, by edges without error."""
    d = graph.dimension
    poses, at = list(graph.poses), 0
    edges, measurements = list(map(tuple, graph.edges)), list(graph.measurements)
    for k in range(2):
        r, t = split(poses[at])
        step = np.full(d, 0.3)
        poses.append(join(r, t + r @ step))
        edges.append((at, graph.num_poses + k))
        measurements.append(join(np.eye(d), step))
        at = graph.num_poses + k
    weights = [tau, tau, 2 * kappa] if d == 2 else [2 * kappa] * 3 + [tau] * 3
    return bundle.PoseGraph(
        poses=np.array(poses),
        edges=np.array(edges, np.int32),
        measurements=np.array(measurements),
        information=np.concatenate([graph.information, np.tile(np.diag(weights), (2, 1, 1))]),
    )


@pytest.mark.parametrize("ratio", [1e3, 1e9, 1e12, 1e14, 1e16])
@pytest.mark.parametrize("dimension", [2, 3])
def test_large_weights_hide_no_planted_minimum(dimension, ratio):
    for turns in (0, 1):
        graph = ring(np.random.default_rng(3), 12, dimension, kappa=0.01, tau=0.1, turns=turns)
        chained = _with_chain(graph, 0.01 * ratio, 0.1 * ratio)
        alone, found = (
            bundle.certify(bundle.solve(one, init="file", max_num_iterations=500), max_rank=0)
            for one in (graph, chained)
        )
        assert alone.verdict == ("not-certified" if turns else "certified")
        if turns or ratio < 1e8:
            assert found.verdict == alone.verdict
        assert (
            found.lower_bound <= alone.cost if not turns else found.lower_bound < 0.1 * alone.cost
        )
        if found.is_certified:
            assert found.gap <= 0.1 * found.cost
    exact = _with_chain(ring(np.random.default_rng(3), 12, dimension, noise=0.0), 50 * ratio, 1.0)
    assert bundle.certify(exact, max_rank=0).verdict == "certified"
    turned = np.array(exact.poses)
    turned[3] = _moved(np.random.default_rng(0), turned[3], 1.0)
    far = bundle.certify(exact.replace(poses=turned), max_rank=0)
    assert far.verdict == "not-a-minimum"
