"""Initial poses: exact where the edges are, near where they are noisy."""

import numpy as np
import pytest

import bundle
from tests.pose_graph import graphs

KINDS = ["odometry", "spanning_tree", "chordal"]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("init", KINDS)
def test_exact_edges_give_exact_poses(dimension, init):
    graph = graphs.loop(dimension, noise=0, start_noise=0)
    rng = np.random.default_rng(1)
    lost = [graphs.random_pose(rng, dimension) for _ in range(11)]
    start = graph.replace(poses=np.concatenate([graph.poses[:1], lost]))
    found = bundle.initial_poses(start, init)
    np.testing.assert_array_equal(found[0], graph.poses[0])
    for pose, truth in zip(found, graph.poses, strict=True):
        np.testing.assert_allclose(graphs.matrix(pose), graphs.matrix(truth), atol=1e-7)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("init", KINDS)
def test_a_fixed_pose_in_the_middle_and_ids_out_of_order(dimension, init):
    graph = graphs.loop(dimension, noise=0, start_noise=0)
    order = np.random.default_rng(4).permutation(12)
    place = np.argsort(order)
    fixed = order == 5
    mixed = graph.replace(
        poses=np.where(fixed[:, None], graph.poses[order], graph.poses[order][::-1]),
        edges=place[graph.edges],
        ids=order,
        fixed=fixed,
    )
    for pose, k in zip(bundle.initial_poses(mixed, init), order, strict=True):
        np.testing.assert_allclose(graphs.matrix(pose), graphs.matrix(graph.poses[k]), atol=1e-7)


@pytest.mark.parametrize("dimension", [2, 3])
def test_chordal_is_near_the_optimum_where_the_file_is_far(dimension):
    graph = graphs.loop(dimension, num_poses=30, num_closures=30, noise=0.01, start_noise=2, seed=7)
    results = {init: bundle.solve(graph, init=init) for init in ("chordal", "auto")}
    for result in results.values():
        assert result.summary.init == "chordal"
        assert result.summary.chi2_initial < 3 * result.summary.chi2_final
    assert results["auto"].summary.init_choice and not results["chordal"].summary.init_choice
    spread = bundle.solve(graph, init="spanning_tree").summary
    assert results["chordal"].summary.chi2_initial < spread.chi2_initial


def test_auto_keeps_poses_that_are_good():
    graph = bundle.solve(graphs.loop(2)).problem
    summary = bundle.solve(graph, init="auto").summary
    assert summary.init == "file" and summary.init_choice


def test_chordal_weighs_edges_by_their_information():
    """Of two edges that contradict each other, the one that is certain counts."""
    graph = bundle.PoseGraph(
        poses=np.zeros((2, 3)),
        edges=[[0, 1], [1, 0]],
        measurements=[[1, 0, 0.3], [-3, 0, 0.5]],
        information=[1e8 * np.eye(3), np.eye(3)],
    )
    found = bundle.initial_poses(graph, "chordal")[1]
    np.testing.assert_allclose(found, [1, 0, 0.3], atol=1e-6)


def test_odometry_with_gaps_says_where():
    graph = graphs.loop(2)
    graph = graph.replace(ids=np.where(graph.ids > 6, graph.ids + 1, graph.ids))
    bundle.solve(graph, init="odometry")  # ids may leave numbers out
    cut = graph.replace(
        edges=np.delete(graph.edges, 6, 0),
        measurements=np.delete(graph.measurements, 6, 0),
        information=np.delete(graph.information, 6, 0),
        edge_lines=np.delete(graph.edge_lines, 6),
    )
    with pytest.raises(bundle.InputError, match=r"^init: expected an edge .* between 6 and 8"):
        bundle.solve(cut, init="odometry")


def test_an_end_above_the_chordal_start_is_said_to_be_a_local_minimum():
    graph = graphs.loop(2, num_poses=30, num_closures=30, noise=0.01, start_noise=2, seed=7)
    circle = np.linspace(0, 2 * np.pi, 31)[:-1]
    twisted = np.stack([np.cos(3 * circle), np.sin(2 * circle), 5 * circle], axis=1)
    ends = {init: bundle.solve(graph.replace(poses=twisted), init=init).summary for init in
            ("file", "chordal")}  # fmt: skip
    assert ends["file"].chi2_final > 1.1 * ends["chordal"].chi2_initial
    assert ends["file"].warning_kinds == ("local_minimum",)
    assert ends["chordal"].warning_kinds == ()
    right = bundle.solve(bundle.solve(graph, init="chordal").problem).summary
    assert right.init == "file" and right.warning_kinds == ()
