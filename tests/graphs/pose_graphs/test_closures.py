"""Odometry and closures by the order of ids: gaps between ids have no influence."""

import json

import numpy as np
import pytest

import bundle
from bundle.cli.main import main
from bundle.graphs.pose_graphs.consistency import closure_consistency
from bundle.reports.page.graph_facts import facts_of_pose_graph
from tests.graphs.pose_graphs import graphs


def with_gaps(graph, seed=3):
    """Return the graph with ids that have gaps, in the same order."""
    gaps = np.random.default_rng(seed).integers(2, 40, graph.num_poses)
    return graph.replace(ids=np.cumsum(gaps)[np.argsort(np.argsort(graph.ids))])


def keys_of_gtsam(letters, numbers):
    return np.array([(ord(a) << 56) + b for a, b in zip(letters, numbers, strict=True)])


def by_ranks(graph):
    """Return the closures by an independent rule: positions in the sorted list of ids."""
    place = {pose_id: k for k, pose_id in enumerate(sorted(graph.ids.tolist()))}
    ends = [[place[pose_id] for pose_id in pair] for pair in graph.ids[graph.edges].tolist()]
    return np.array([abs(a - b) != 1 for a, b in ends])


def wrong(graph, edge=-1):
    measurements = graph.measurements.copy()
    measurements[edge, -2] += 2.0
    return graph.replace(measurements=measurements)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("is_shuffled", [False, True])
def test_gaps_change_no_closure(dimension, is_shuffled):
    graph = graphs.loop(dimension)
    if is_shuffled:
        graph = graph.replace(ids=np.random.default_rng(1).permutation(graph.num_poses))
    sparse = with_gaps(graph)
    assert 0 < graph.is_closure.sum() < graph.num_edges
    np.testing.assert_array_equal(graph.is_closure, by_ranks(graph))
    np.testing.assert_array_equal(sparse.is_closure, graph.is_closure)


@pytest.mark.parametrize(
    "options",
    [
        {"loss": "cauchy"},
        {"loss": "gnc-tls"},
        {"loss": "auto"},
        {"consistency": True},
        {"init": "odometry"},
        {"init": "auto"},
    ],
    ids=str,
)
@pytest.mark.parametrize("dimension", [2, 3])
def test_gaps_change_no_solve(dimension, options):
    graph = wrong(graphs.loop(dimension))
    dense, sparse = (bundle.solve(one, **options) for one in (graph, with_gaps(graph)))
    np.testing.assert_array_equal(dense.problem.poses, sparse.problem.poses)
    np.testing.assert_array_equal(dense.weights, sparse.weights)
    assert dense.rejected == sparse.rejected and dense.left_out == sparse.left_out
    assert dense.summary.init == sparse.summary.init


def test_a_loss_on_closures_leaves_odometry_with_gaps_alone():
    graph = with_gaps(wrong(graphs.loop(2), edge=4))
    weights = bundle.solve(graph, loss="cauchy").weights
    assert (weights[~graph.is_closure] == 1).all() and (weights[graph.is_closure] < 1).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_gaps_change_no_analysis(dimension):
    graph = bundle.solve(graphs.loop(dimension)).problem
    sparse = with_gaps(graph)
    kinds, others = bundle.chi2_kinds(graph), bundle.chi2_kinds(sparse)
    assert kinds == others and {kind.kind for kind in kinds} == {"odometry", "closure", "all"}
    assert closure_consistency(graph) == closure_consistency(sparse)
    assert facts_of_pose_graph(graph).kinds.tolist() == facts_of_pose_graph(sparse).kinds.tolist()


@pytest.mark.parametrize("command", ["info", "inspect", "diagnose", "check"])
def test_gaps_change_no_report(tmp_path, command, capsys):
    graph = bundle.solve(graphs.loop(2)).problem
    found = []
    for name, one in (("dense", graph), ("sparse", with_gaps(graph))):
        path = tmp_path / f"{name}.g2o"
        bundle.save(one, path)
        main([command, str(path), "--json", str(tmp_path / f"{name}.json")])
        found.append((tmp_path / f"{name}.json").read_text())
    capsys.readouterr()
    dense, sparse = (_counts(json.loads(text)) for text in found)
    assert dense == sparse


def _counts(value):
    """Return the numbers of kinds in a report."""
    if isinstance(value, dict):
        kept = {k: v for k, v in value.items() if "closure" in k or k in ("kind", "kinds", "count")}
        return [kept, *(_counts(one) for one in value.values())]
    return [_counts(one) for one in value] if isinstance(value, list) else []


@pytest.mark.parametrize("letters", ["ab", "\0A", "AB"])  # \0: plain numbers
def test_letters_of_gtsam_part_trajectories(letters):
    graph = graphs.loop(2, num_poses=10)
    keys = keys_of_gtsam(letters[0] * 5 + letters[1] * 5, [*range(5), *range(0, 50, 10)])
    graph = graph.replace(ids=keys)
    expected = by_ranks(graph)
    join = graph.edges.tolist().index([4, 5])
    assert not expected[join]
    expected[join] = True
    np.testing.assert_array_equal(graph.is_closure, expected)
    with pytest.raises(bundle.InputError, match="gap"):
        bundle.solve(graph, init="odometry")


def test_time_stamps_in_nanoseconds_are_no_letters():
    graph = graphs.loop(2)
    last_before = (20 << 56) - 6 * 10**9 - 1  # 1.4e18 ns: the year 2015
    stamps = last_before + 10**9 * np.arange(graph.num_poses)
    assert (stamps >> 56).min() == 19 and (stamps >> 56).max() == 20
    np.testing.assert_array_equal(graph.replace(ids=stamps).is_closure, graph.is_closure)


def test_ids_of_shared_graphs_have_the_closures_that_differences_of_ids_tell(bundle_data):
    paths = sorted((bundle_data / "g2o").glob("*.g2o*"))
    assert len(paths) >= 8
    for path in paths:
        graph = bundle.load(path)
        apart = np.abs(np.diff(graph.ids[graph.edges], axis=1)[:, 0])
        np.testing.assert_array_equal(graph.is_closure, apart != 1)


def test_duplicates_and_reversed_edges_of_neighbors_are_odometry():
    graph = graphs.loop(2)
    again = graph.replace(
        edges=np.concatenate([graph.edges, graph.edges[:2, ::-1], graph.edges[:2]]),
        measurements=np.concatenate([graph.measurements, *[graph.measurements[:2]] * 2]),
        information=np.concatenate([graph.information, *[graph.information[:2]] * 2]),
        edge_lines=None,
    )
    assert not with_gaps(again).is_closure[-4:].any()
