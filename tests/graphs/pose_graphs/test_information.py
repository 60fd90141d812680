"""Information matrices that are none."""

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.graphs.pose_graphs.edge_weights import densest_set, weighted_graph
from tests.graphs.pose_graphs import graphs

ASYMMETRIC = [[1, 0.5, 0], [0.4, 1, 0], [0, 0, 1]]
INDEFINITE = [[1, 2, 0], [2, 1, 0], [0, 0, 1]]
NEGATIVE = np.diag([1.0, 1, -1])
NAN = [[1, 0, 0], [0, np.nan, 0], [0, 0, 1]]


def with_information(matrix, edge=4):
    graph = graphs.loop(2)
    information = graph.information.copy()
    information[edge] = matrix
    return graph.replace(information=information, path="x.g2o", edge_lines=np.arange(17) + 13)


@pytest.mark.parametrize(
    ("matrix", "found"),
    [
        (ASYMMETRIC, "symmetric matrix, found 0.5 and 0.4"),
        (INDEFINITE, "eigenvalues from -1 to 3"),
        (NEGATIVE, "eigenvalues from -1 to 1"),
        (NAN, "finite numbers"),
    ],
)
def test_bad_information_is_refused_by_its_edge(matrix, found):
    for call in (bundle.solve, bundle.pose_graph_chi2, bundle.initial_poses):
        with pytest.raises(bundle.InputError) as caught:
            call(with_information(matrix))
        assert str(caught.value).startswith("x.g2o:17: edge 4 5: information: expected ")
        assert found in str(caught.value) and "information=isotropic" in str(caught.value)
        assert "likewise" not in str(caught.value)


@pytest.mark.parametrize(("asked", "used"), [(1, 1), (2, 2), (3, 2), (0, 2)])
def test_threads_are_those_asked_for_up_to_the_cores(monkeypatch, asked, used):
    monkeypatch.setattr(_core, "hardware_threads", lambda: 2)
    found = weighted_graph(graphs.loop(2), None, {"num_threads": asked}, "covariance")
    assert found.options.num_threads == used


def test_several_are_counted():
    information = np.tile(INDEFINITE, (17, 1, 1)).astype(float)
    with pytest.raises(bundle.InputError, match="likewise 16 more edges"):
        bundle.solve(graphs.loop(2).replace(information=information))


def test_isotropic_takes_the_means_of_the_diagonals():
    graph = with_information(np.diag([1.0, 3, 7]) + 5 * np.eye(3)[[1, 0, 2]] * [1, 1, 0])
    with pytest.raises(bundle.InputError, match="positive semidefinite"):
        bundle.solve(graph)
    found = bundle.solve(graph, information="isotropic")
    means = [np.diag([d[:2].mean()] * 2 + [d[2]]) for d in map(np.diag, graph.information)]
    assert means[4].tolist() == np.diag([2.0, 2, 7]).tolist()
    expected = bundle.solve(graph.replace(information=np.array(means)))
    np.testing.assert_allclose(found.problem.poses, expected.problem.poses, atol=1e-9)
    np.testing.assert_array_equal(found.problem.information, graph.information)


def test_isotropic_in_space_has_a_number_for_rotation_and_one_for_translation():
    graph = graphs.loop(3)
    diagonal = np.diagonal(graph.information, axis1=1, axis2=2)
    means = np.repeat(diagonal.reshape(-1, 2, 3).mean(2), 3, axis=1)
    expected = bundle.solve(graph.replace(information=means[:, :, None] * np.eye(6)))
    found = bundle.solve(graph, information="isotropic")
    np.testing.assert_allclose(found.summary.chi2_final, expected.summary.chi2_final, rtol=1e-9)


def test_isotropic_needs_means_above_zero():
    with pytest.raises(bundle.InputError, match=r"x.g2o:17: edge 4 5: .* found 1, -1"):
        bundle.solve(with_information(NEGATIVE), information="isotropic")


def test_what_rounding_leaves_is_no_mistake():
    """A product of matrices, symmetric up to the last bits; eigenvalues of 1e-9 beside 1e6."""
    rng = np.random.default_rng(2)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    matrix = turn @ np.diag([1e6, 1.0, 1e-9]) @ turn.T
    matrix[0, 1] *= 1 + 1e-13
    assert bundle.solve(with_information(matrix)).summary.is_solution_usable


@pytest.mark.parametrize("joined", [True, False], ids=["odometry", "spanning tree"])
def test_a_file_of_edges_alone_is_read_whatever_its_information_says(tmp_path, joined):
    """Where poses start does not depend on it; a solve refuses it by file and line."""
    graph = graphs.loop(2)
    information = graph.information.copy()
    information[4] = INDEFINITE
    ids = graph.ids if joined else 10 * graph.ids
    bundle.save(graph.replace(information=information, ids=ids), tmp_path / "whole.g2o")
    lines = (tmp_path / "whole.g2o").read_text().splitlines(keepends=True)
    path = tmp_path / "edges.g2o"
    path.write_text("".join(line for line in lines if line.startswith("EDGE")))
    found = bundle.load(path)
    np.testing.assert_array_equal(found.information, information)
    with pytest.raises(
        bundle.InputError, match=r"edges.g2o:5: edge \d+ \d+: information: expected"
    ):
        bundle.solve(found)
    assert bundle.solve(found, information="isotropic").summary.is_solution_usable


@pytest.mark.parametrize(
    ("edges", "size"),
    [
        ([], 0),
        ([[0, 1]], 2),
        ([[0, 1], [1, 0], [0, 1]], 2),  # repeated and reversed
        ([[0, 1], [1, 2]], 2),
        ([[0, 1], [1, 2], [2, 0], [2, 7]], 3),
        ([[0, k] for k in range(1, 9)], 2),  # a star
        ([[a, b] for a in range(5) for b in range(a)], 5),
    ],
)
def test_d_vertices_with_d_minus_one_neighbours(edges, size):
    assert densest_set(np.array(edges, np.int32).reshape(-1, 2)) == size


@pytest.mark.parametrize("source", [3, None, [("a", "b")]])
def test_other_objects_are_no_graph(source):
    for function in (
        bundle.certify,
        bundle.initial_poses,
        bundle.pose_graph_chi2,
        lambda graph: weighted_graph(graph, None, {}, "covariance"),
    ):
        with pytest.raises(bundle.InputError, match="graph: expected"):
            function(source)
