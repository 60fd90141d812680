"""Undetermined and weak joints with planted information on both sides of each threshold."""

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.graphs.pose_graphs import joints
from bundle.graphs.pose_graphs.joints import find_joints, typical_sigmas
from tests.graphs.pose_graphs.graphs import error_by_matrices, matrix, pose_of, random_pose


def bridged(dimension, bridge, *, sizes=(4, 3), seed=0):
    """Return two chains at exact measurements, joined by an edge with information `bridge`.

    The information of all other edges is 4 on the rotation and 25 on the translation: typical
    sigmas are 1/2 and 1/5.
    """
    rng = np.random.default_rng(seed)
    d, first = (3, 3) if dimension == 2 else (6, 6)
    weights = [25.0, 25.0, 4.0] if dimension == 2 else [4.0] * 3 + [25.0] * 3
    count = sum(sizes)
    poses = np.array([random_pose(rng, dimension) for _ in range(count)])
    ends = [(k, k + 1) for k in range(count - 1)]
    measured = [pose_of(np.linalg.inv(matrix(poses[i])) @ matrix(poses[j])) for i, j in ends]
    information = np.tile(np.diag(weights), (count - 1, 1, 1))
    information[sizes[0] - 1] = bridge
    assert information.shape[1:] == (d, first)
    return bundle.PoseGraph(
        poses=poses, edges=ends, measurements=np.array(measured), information=information
    )


def scaled(dimension, values, turn):
    """Return information with these eigenvalues in typical sigmas, and turned eigenvectors."""
    sigmas = np.array([0.2, 0.2, 0.5] if dimension == 2 else [0.5] * 3 + [0.2] * 3)
    d = len(sigmas)
    axes = np.linalg.qr(np.random.default_rng(turn).normal(size=(d, d)))[0] if turn else np.eye(d)
    return (axes * np.resize(values, d)) @ axes.T / np.outer(sigmas, sigmas)


def found_in(graph, error="log"):
    held, _, _ = _core.hold_poses(graph)
    return find_joints(graph, held, error)


@pytest.mark.parametrize("dimension", [2, 3])
def test_typical_sigmas_are_medians(dimension):
    graph = bridged(dimension, scaled(dimension, [1e-9], 0), sizes=(5, 4))
    expected = [0.2, 0.2, 0.5] if dimension == 2 else [0.5] * 3 + [0.2] * 3
    np.testing.assert_allclose(typical_sigmas(graph), expected, rtol=1e-12)


@pytest.mark.parametrize("turn", [0, 1])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("least", "num_weak"), [(0.99e-4, 1), (1.01e-4, 0)])
def test_a_weak_joint(dimension, turn, least, num_weak):
    d = 3 if dimension == 2 else 6
    values = np.ones(d)
    values[0] = least
    graph = bridged(dimension, scaled(dimension, values, turn))
    found = found_in(graph)
    assert found.is_exact and not found.opened and found.num_open == 0
    assert found.directions.shape == (d * 7, 0)
    assert len(found.weak) == num_weak
    for joint in found.weak:
        # the smaller cluster, its reference at the edge: the information of the edge itself
        assert joint.poses.tolist() == [4, 5, 6] and joint.edges.tolist() == [3]
        np.testing.assert_allclose(joint.eigenvalues, np.sort(values), rtol=1e-6)
        assert (joint.num_weak, joint.num_open) == (1, 0)
        still = joint.vectors[:, 0]
        sigmas = typical_sigmas(graph)
        moved = graph.information[3] * np.outer(sigmas, sigmas) @ still
        np.testing.assert_allclose(moved, least * still, atol=1e-9)


@pytest.mark.parametrize("turn", [0, 1])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("least", "num_open"), [(0.5e-13, 1), (2e-13, 0)])
def test_an_undetermined_joint(dimension, least, num_open, turn):
    d = 3 if dimension == 2 else 6
    values = np.ones(d)
    values[-1] = least
    if turn:  # a direction across the axes, exactly undetermined or clearly not
        values[-1] = 0.0 if num_open else 1e-11
    graph = bridged(dimension, scaled(dimension, values, turn), seed=3)
    found = found_in(graph)
    assert found.num_open == num_open == len(found.opened) == found.directions.shape[1]
    assert len(found.weak) == 1 - num_open
    for joint in found.opened:
        assert joint.num_open == 1 and joint.poses.tolist() == [4, 5, 6]
        assert joint.num_weak == 0
    if num_open:
        moves = found.directions.reshape(7, d)
        assert np.abs(moves[:4]).max() == 0  # the first pose is held, and its cluster with it
        assert np.linalg.norm(moves[4:]) > 0
        moves *= 1e-4 / np.abs(moves).max()
        manifold = "se2" if dimension == 2 else "se3"
        both = zip(graph.poses, moves, strict=True)
        there = np.array([_core.retract(manifold, pose, move) for pose, move in both])
        left = bundle.pose_graph_chi2(graph.replace(poses=there))
        assert left.max() < 1e-12 and np.abs(there - graph.poses).max() > 1e-6


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_middle_cluster_carries_the_next_one(dimension):
    """Three clusters in a row: the last hangs on the middle one, which moves with it."""
    d = 3 if dimension == 2 else 6
    values = np.ones(d)
    values[0] = 0.5e-4
    graph = bridged(dimension, scaled(dimension, values, 1), sizes=(4, 3))
    information = graph.information.copy()
    information[5] = information[3]  # the last pose by itself
    found = found_in(graph.replace(information=information))
    assert [joint.poses.tolist() for joint in found.weak] == [[6], [4, 5, 6]]
    assert [joint.edges.tolist() for joint in found.weak] == [[5], [3]]
    # a fixed pose in the last cluster makes it the reference
    fixed = np.zeros(7, bool)
    fixed[6] = True
    other = found_in(graph.replace(information=information, fixed=fixed))
    assert sorted(sorted(joint.poses.tolist()) for joint in other.weak) == [
        [0, 1, 2, 3],
        [0, 1, 2, 3, 4, 5],
    ]


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_ring_of_clusters_is_judged_by_all_edges_of_a_cluster(dimension):
    """Three clusters and three edges of one direction each: no cluster is a leaf."""
    d = 3 if dimension == 2 else 6
    one = np.zeros(d)
    one[0] = 1.0
    graph = bridged(dimension, scaled(dimension, one, 1), sizes=(3, 4))
    information = graph.information.copy()
    information[4] = scaled(dimension, one, 2)
    back = pose_of(np.linalg.inv(matrix(graph.poses[6])) @ matrix(graph.poses[0]))
    ring = graph.replace(
        edges=[*graph.edges, (6, 0)],
        measurements=[*graph.measurements, back],
        information=[*information, scaled(dimension, one, 3)],
        edge_lines=None,
    )
    found = found_in(ring)
    assert sorted(joint.poses.tolist() for joint in found.opened) == [[3, 4], [5, 6]]
    assert sorted(joint.edges.tolist() for joint in found.opened) == [[2, 4], [4, 6]]
    assert [joint.num_open for joint in found.opened] == [d - 2] * 2
    assert found.is_exact and found.num_open == 2 * d - 3


@pytest.mark.parametrize(("most", "is_exact"), [(3, True), (2, False)])
def test_many_clusters_are_counted_one_by_one(monkeypatch, most, is_exact):
    values = np.ones(3)
    values[0] = 0.0
    graph = bridged(2, scaled(2, values, 0))
    information = graph.information.copy()
    information[5] = information[3]
    monkeypatch.setattr(joints, "MOST_CLUSTERS", most)
    found = found_in(graph.replace(information=information))
    assert found.is_exact == is_exact and found.num_open == 2
    assert found.directions.shape == (21, 2 if is_exact else 0)


@pytest.mark.parametrize(("error", "part"), [("log", 1.0), ("ceres", 1.0), ("g2o", 0.25)])
def test_the_error_of_edges_has_its_own_eigenvalues(error, part):
    """g2o's rotation vector has half the length: a quarter of the information."""
    values = np.ones(6)
    values[:3] = 0.5e-4
    (joint,) = found_in(bridged(3, scaled(3, values, 0)), error).weak
    np.testing.assert_allclose(joint.eigenvalues[:3], part * 0.5e-4, rtol=1e-6)


@pytest.mark.parametrize("dimension", [2, 3])
def test_two_edges_at_different_poses_hold_a_cluster_together(dimension):
    """The information is that of a rigid motion of the cluster, by differences of matrices."""
    d = 3 if dimension == 2 else 6
    values = np.full(d, 1e-6)
    values[0] = 1e-9
    chain = bridged(dimension, scaled(dimension, values, 1))
    poses = chain.poses
    graph = chain.replace(
        edges=np.vstack([chain.edges, [[1, 6]]]),
        measurements=np.vstack(
            [chain.measurements, pose_of(np.linalg.inv(matrix(poses[1])) @ matrix(poses[6]))]
        ),
        information=np.concatenate([chain.information, chain.information[3:4]]),
        edge_lines=np.zeros(7, np.int64),
    )
    (joint,) = found_in(graph).weak
    assert joint.poses.tolist() == [4, 5, 6] and joint.edges.tolist() == [3, 6]
    rows = []
    manifold = "se2" if dimension == 2 else "se3"
    for edge, (i, j) in ((3, (3, 4)), (6, (1, 6))):
        weights, axes = np.linalg.eigh(graph.information[edge])
        root = np.sqrt(weights)[:, None] * axes.T
        columns = []
        for step in 1e-6 * np.eye(d):
            sides = []
            for sign in (1, -1):
                moved = matrix(_core.retract(manifold, poses[4], sign * step))
                there = moved @ np.linalg.inv(matrix(poses[4])) @ matrix(poses[j])
                error = error_by_matrices("log", poses[i], pose_of(there), graph.measurements[edge])
                sides.append(root @ error)
            columns.append((sides[0] - sides[1]) / 2e-6)
        rows.append(np.array(columns).T * typical_sigmas(graph))
    stacked = np.vstack(rows)
    expected = np.linalg.eigvalsh(stacked.T @ stacked)
    np.testing.assert_allclose(joint.eigenvalues, expected, rtol=1e-5)
