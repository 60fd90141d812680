"""The graph of similarities against 4 x 4 matrices and SciPy's dense least squares."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from bundle import _core
from bundle.graphs.loops.similarity_graph import Nodes, SimilarityGraph


def random_poses(rng, count, angle=1.0):
    return np.hstack(
        [
            Rotation.from_rotvec(angle * rng.normal(size=(count, 3))).as_quat(),
            rng.normal(size=(count, 3)),
        ]
    )


def matrix(pose, scale=1.0):
    found = np.eye(4)
    found[:3, :3] = scale * Rotation.from_quat(pose[:4]).as_matrix()
    found[:3, 3] = pose[4:]
    return found


def residual(graph, nodes, edge):
    """Error of one edge, by matrices."""
    i, j = graph.edges[edge]
    a = matrix(nodes.poses[i], nodes.scales[i]) @ matrix(graph.mounts[edge, 0])
    b = matrix(nodes.poses[j], nodes.scales[j]) @ matrix(graph.mounts[edge, 1])
    error = np.linalg.inv(matrix(graph.measurements[edge])) @ np.linalg.inv(a) @ b
    scale = np.cbrt(np.linalg.det(error[:3, :3]))
    turn = Rotation.from_matrix(error[:3, :3] / scale).as_rotvec()
    return np.concatenate([turn, error[:3, 3], [np.log(scale)]])


def some_graph(seed=0, n=5, *, free=True, mounted=True):
    rng = np.random.default_rng(seed)
    edges = np.array([(k, k + 1) for k in range(n - 1)] + [(n - 1, 0), (3, 1), (1, 3)])
    m = len(edges)
    mounts = np.tile([0, 0, 0, 1.0, 0, 0, 0], (m, 2, 1))
    if mounted:
        mounts = random_poses(rng, 2 * m).reshape(m, 2, 7)
    root = rng.normal(size=(m, 7, 7))
    information = root @ np.swapaxes(root, 1, 2)
    information[-1, 6] = information[-1, :, 6] = 0
    nodes = Nodes(random_poses(rng, n), np.exp(0.2 * rng.normal(size=n)) if free else np.ones(n))
    graph = SimilarityGraph(
        edges=edges,
        mounts=mounts,
        measurements=random_poses(rng, m, 0.3),
        information=information,
        held=np.arange(n) == 2,
        has_free_scales=free,
    )
    # Measured near what the nodes say, so that there is one minimum nearby.
    z = [matrix_pose(graph, nodes, e) for e in range(m)]
    noisy = np.array(z) + 0.05 * rng.normal(size=(m, 7))
    noisy[:, :4] /= np.linalg.norm(noisy[:, :4], axis=1, keepdims=True)
    return SimilarityGraph(**{**vars(graph), "measurements": noisy}), nodes


def matrix_pose(graph, nodes, edge):
    i, j = graph.edges[edge]
    a = matrix(nodes.poses[i], nodes.scales[i]) @ matrix(graph.mounts[edge, 0])
    b = matrix(nodes.poses[j], nodes.scales[j]) @ matrix(graph.mounts[edge, 1])
    relative = np.linalg.inv(a) @ b
    scale = np.cbrt(np.linalg.det(relative[:3, :3]))
    return np.concatenate(
        [Rotation.from_matrix(relative[:3, :3] / scale).as_quat(), relative[:3, 3]]
    )


def trivial(chi2):
    return chi2, np.ones(len(chi2))


def test_residuals_are_those_of_matrices():
    graph, nodes = some_graph()
    expected = [residual(graph, nodes, edge) for edge in range(len(graph.edges))]
    np.testing.assert_allclose(graph.residuals(nodes), expected, atol=1e-12)


@pytest.mark.parametrize(("free", "mounted"), [(True, True), (False, True)])
def test_minimum_is_that_of_dense_least_squares(free, mounted):
    graph, nodes = some_graph(1, free=free, mounted=mounted)
    roots = [np.linalg.cholesky(w + 1e-14 * np.eye(7)).T for w in graph.information]
    size = 7 if free else 6
    movable = np.flatnonzero(~graph.held)

    def errors(x):
        step = np.zeros((len(graph.held), 7))
        step[movable, :size] = x.reshape(-1, size)
        moved = Nodes(
            np.hstack(
                [
                    (
                        Rotation.from_quat(nodes.poses[:, :4]) * Rotation.from_rotvec(step[:, :3])
                    ).as_quat(),
                    nodes.poses[:, 4:] + step[:, 3:6],
                ]
            ),
            nodes.scales * np.exp(step[:, 6]),
        )
        return np.concatenate([r @ residual(graph, moved, e) for e, r in enumerate(roots)])

    best = least_squares(errors, np.zeros(len(movable) * size), xtol=1e-10, ftol=1e-10)
    found = graph.solve(nodes, trivial, 1e-14)
    assert 0.5 * graph.chi2(nodes).sum() > 1.01 * best.cost
    np.testing.assert_allclose(0.5 * graph.chi2(found).sum(), best.cost, rtol=1e-7)
    np.testing.assert_array_equal(found.poses[graph.held], nodes.poses[graph.held])
    assert free or (found.scales == 1).all()


def test_held_nodes_keep_their_bits():
    """Also where a normalised quaternion is none to the last bit."""
    graph, nodes = some_graph()
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(200, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    again = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    nodes.poses[graph.held, :4] = turns[(turns != again).any(axis=1)][0]
    before = nodes.poses[graph.held].copy()
    found = graph.solve(nodes, trivial, 1e-14)
    np.testing.assert_array_equal(found.poses[graph.held], before)


def test_the_step_is_quadratic_near_the_minimum():
    """Wrong Jacobians would still find minima of this kind, slowly."""
    graph, nodes = some_graph(2)
    graph = SimilarityGraph(**{**vars(graph), "measurements": _consistent(graph, nodes)})
    rng = np.random.default_rng(3)
    off = 1e-3 * rng.normal(size=(5, 7)) * ~graph.held[:, None]
    start = nodes.moved(off)
    free = np.flatnonzero(~graph.held)
    diagonal, between, gradient = graph._normal(start, np.ones(len(graph.edges)), free)
    step = np.zeros((5, 7))
    step[free] = graph._step(diagonal, between, gradient, free, 0.0)
    left = graph.chi2(start.moved(step)).sum() / graph.chi2(start).sum()
    assert left < 1e-4


def _consistent(graph, nodes):
    nodes.scales[:] = 1
    return np.array([matrix_pose(graph, nodes, e) for e in range(len(graph.edges))])


@pytest.mark.parametrize("size", [1, 6, 7])
def test_an_edge_system_is_that_of_dense_algebra(size):
    rng = np.random.default_rng(size)
    edges = np.array([(0, 1), (3, 1), (1, 3), (4, 0), (2, 4)], np.int32)
    between = rng.normal(size=(5, size, size))
    dense = np.zeros((5 * size, 5 * size))
    for (a, b), block in zip(edges, between, strict=True):
        dense[a * size : (a + 1) * size, b * size : (b + 1) * size] += block
        dense[b * size : (b + 1) * size, a * size : (a + 1) * size] += block.T
    dense += 10 * size * np.eye(5 * size)
    diagonal = np.stack([10 * size * np.eye(size)] * 5)
    rhs = rng.normal(size=(5, size))
    found = _core.solve_edge_system(edges, diagonal, between, rhs)
    np.testing.assert_allclose(found.ravel(), np.linalg.solve(dense, rhs.ravel()), rtol=1e-10)
    assert _core.solve_edge_system(edges, -diagonal, between, rhs) is None
    with pytest.raises(ValueError, match="nodes"):
        _core.solve_edge_system(edges + 1, diagonal, between, rhs)
