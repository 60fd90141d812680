"""Closures that agree pair by pair: their chi2 by differences of matrices, sets by enumeration."""

import itertools
import json
import sys

import numpy as np
import pytest
from scipy.linalg import logm
from scipy.stats import chi2 as chi2_distribution

import bundle
from bundle import _core
from bundle.base.tails import ONE_IN_A_MILLION
from bundle.graphs.pose_graphs import consistency, lie_groups
from bundle.graphs.pose_graphs.consistency import odometry_chain
from tests.graphs.pose_graphs import graphs
from tests.graphs.pose_graphs.test_wrong_closures import certain_loop, distance, with_wrong_closures


def test_quantiles():
    for d, quantile in ONE_IN_A_MILLION.items():
        np.testing.assert_allclose(quantile, chi2_distribution.isf(1e-6, d), rtol=1e-12)


def largest_by_enumeration(conflicts):
    n = len(conflicts)
    for size in range(n, 0, -1):
        for chosen in itertools.combinations(range(n), size):
            if not conflicts[np.ix_(chosen, chosen)].any():
                return size
    return 0


def random_conflicts(rng, n, share):
    upper = np.triu(rng.random((n, n)) < share, 1)
    return upper | upper.T


def test_the_largest_set_is_that_of_enumeration(monkeypatch):
    rng = np.random.default_rng(0)
    by_integers = []
    solve = consistency._by_integers
    monkeypatch.setattr(
        consistency, "_by_integers", lambda given: by_integers.append(1) or solve(given)
    )
    for trial in range(60):
        conflicts = random_conflicts(rng, 9, (0.1, 0.3, 0.6)[trial % 3])
        chosen, proven = consistency.largest_set(conflicts)
        assert proven and not conflicts[np.ix_(chosen, chosen)].any()
        assert chosen.sum() == largest_by_enumeration(conflicts)
        greedy = consistency._greedy(conflicts)
        assert not conflicts[np.ix_(greedy, greedy)].any()
        assert (greedy | conflicts[:, greedy].any(axis=1)).all()  # nothing can be added
    assert 0 < len(by_integers) < 60  # both ways were gone


def test_without_time_the_set_is_greedy_and_unproven(monkeypatch):
    monkeypatch.setattr(consistency, "TIME_LIMIT", 0.0)
    conflicts = random_conflicts(np.random.default_rng(1), 60, 0.3)
    chosen, proven = consistency.largest_set(conflicts)
    assert not proven and chosen.sum() >= 5
    assert not conflicts[np.ix_(chosen, chosen)].any()


def chain_with_agreeing_closures(rng, dimension, ends):
    """Odometry, some edges of it backwards, and closures that all want the same correction."""
    truth = [graphs.random_pose(rng, dimension, size=2.0) for _ in range(8)]
    steps = [(k, k + 1) if rng.random() < 0.6 else (k + 1, k) for k in range(7)]
    at = [graphs.matrix(pose) for pose in truth]
    drift = graphs.matrix(graphs.random_pose(rng, dimension, size=1.0, angle=0.5))
    measured = [np.linalg.inv(at[i]) @ at[j] for i, j in steps]
    measured += [np.linalg.inv(at[i]) @ drift @ at[j] for i, j in ends]
    slight = graphs.random_pose(rng, dimension, size=1e-5, angle=1e-5)
    measured[-1] = measured[-1] @ graphs.matrix(slight)
    d = 3 if dimension == 2 else 6
    edges = np.array([*steps, *ends])
    return bundle.PoseGraph(
        poses=np.array(truth),
        edges=edges,
        measurements=np.array([graphs.pose_of(found) for found in measured]),
        information=np.array([graphs.random_information(rng, d) for _ in edges]),
        ids=np.arange(8) + 5,
    )


def vector(motion):
    algebra = logm(motion).real
    if len(motion) == 3:
        return np.array([algebra[0, 2], algebra[1, 2], algebra[1, 0]])
    return np.array([algebra[2, 1], algebra[0, 2], algebra[1, 0], *algebra[:3, 3]])


def loop_error(graph, measurements):
    """Around a, odometry, b and odometry again: edges 7 and 8 are a and b."""
    at = [graphs.matrix(measurements[0]) * 0 + np.eye(graph.dimension + 1)]
    for (i, j), z in zip(graph.edges[:7], measurements[:7], strict=True):
        at.append(at[-1] @ (graphs.matrix(z) if j > i else np.linalg.inv(graphs.matrix(z))))
    (i, j), (k, m) = graph.edges[7:]
    first, second = graphs.matrix(measurements[7]), graphs.matrix(measurements[8])
    there, back = np.linalg.inv(at[i]) @ at[k], np.linalg.inv(at[m]) @ at[j]
    return vector(np.linalg.inv(first) @ there @ second @ back)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(
    "ends",
    [
        [(0, 3), (4, 7)],
        [(0, 7), (2, 4)],
        [(0, 5), (2, 7)],
        [(5, 0), (2, 7)],
        [(4, 7), (0, 2)],
        [(6, 1), (7, 2)],
    ],
)
def test_chi2_of_a_pair_is_that_of_differences(dimension, ends):
    graph = chain_with_agreeing_closures(np.random.default_rng(len(str(ends))), dimension, ends)
    d, manifold = graph.tangent_size, "se2" if dimension == 2 else "se3"
    jacobian = np.zeros((d, 9 * d))
    for edge, c in itertools.product(range(9), range(d)):
        found = []
        for sign in (1, -1):
            moved = graph.measurements.copy()
            moved[edge] = _core.retract(manifold, moved[edge], sign * 1e-6 * np.eye(d)[c])
            found.append(loop_error(graph, moved))
        jacobian[:, edge * d + c] = (found[0] - found[1]) / 2e-6
    covariance = sum(
        jacobian[:, d * e : d * e + d]
        @ np.linalg.inv(graph.information[e])
        @ jacobian[:, d * e : d * e + d].T
        for e in range(9)
    )
    error = loop_error(graph, graph.measurements)
    chi2 = consistency.pair_chi2(graph, np.array([7, 8]), odometry_chain(graph, 1))
    np.testing.assert_allclose(chi2[0, 1], error @ np.linalg.solve(covariance, error), rtol=1e-3)
    np.testing.assert_array_equal(chi2, chi2.T)


@pytest.mark.parametrize("dimension", [2, 3])
def test_logarithms(dimension):
    rng = np.random.default_rng(3)
    poses = [graphs.random_pose(rng, dimension, angle=a) for a in (0, 1e-9, 1e-4, 0.1, 1, 1.5)]
    found = lie_groups.logarithm(np.array(poses))
    expected = [vector(graphs.matrix(pose)) for pose in poses]
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_wrong_closures_are_left_out_and_the_rest_is_solved(dimension):
    graph = certain_loop(dimension, num_poses=40, num_closures=40, noise=0.005)
    bad = with_wrong_closures(graph, 8)
    for init in ("file", "chordal"):
        clean = bundle.solve(graph, init=init)
        result = bundle.solve(bad, consistency=True, init=init)
        assert sorted(entry.edge for entry in result.left_out) == list(range(79, 87))
        assert result.summary.num_left_out_edges == 8 and result.rejected == ()
        assert distance(result.problem, clean.problem) == 0
        np.testing.assert_array_equal(result.weights, [1] * 79 + [0] * 8)
        np.testing.assert_array_equal(result.chi2_before[:79], clean.chi2_before)
        after = bundle.pose_graph_chi2(result.problem)
        np.testing.assert_allclose(result.chi2_after, after, rtol=1e-9)
        assert (result.chi2_before[79:] > 0).all()
        assert result.summary.chi2_final == clean.summary.chi2_final
        for graph_of_all in (result.problem, result.initial_problem):
            np.testing.assert_array_equal(graph_of_all.edges, bad.edges)
    worst = [entry.chi2 for entry in result.left_out]
    assert worst == sorted(worst, reverse=True)
    assert worst[-1] > ONE_IN_A_MILLION[graph.tangent_size]
    assert all(1 <= entry.num_contradicted <= 40 for entry in result.left_out)
    certainty, expected = bundle.covariance(result), bundle.covariance(clean)
    np.testing.assert_array_equal(certainty.pose_covariance, expected.pose_covariance)
    with pytest.raises(bundle.InputError, match=r"^consistency: expected the result"):
        bundle.covariance(bad, consistency=True)


def test_edges_that_a_loss_rejects_are_those_of_the_whole_graph():
    graph = certain_loop(2, num_poses=40, num_closures=40, noise=0.005)
    bad = with_wrong_closures(graph, 4)
    order = np.concatenate([np.arange(79, 83), np.arange(79)])
    shuffled = bad.replace(edges=bad.edges[order], measurements=bad.measurements[order])
    shuffled = shuffled.replace(information=bad.information[order])
    measured = shuffled.measurements.copy()
    measured[10, 0] += 0.3  # of the odometry, which nothing but a loss leaves out
    result = bundle.solve(
        shuffled.replace(measurements=measured), loss="dcs", loss_on="all", consistency=True
    )
    out = [entry.edge for entry in result.left_out]
    assert {0, 1, 2, 3} <= set(out) and result.rejected == (10,)
    assert (result.weights[out] == 0).all() and 0 < result.weights[10] < 0.5


def test_without_closures_there_is_nothing_to_leave_out():
    result = bundle.solve(graphs.loop(2, num_closures=0), consistency=True)
    assert result.left_out == () and result.summary.warnings == ()


def test_two_that_contradict_each_other_are_said_to_be_no_majority():
    graph = with_wrong_closures(certain_loop(2, num_closures=1, noise=0), 1)
    result = bundle.solve(graph, consistency=True)
    assert len(result.left_out) == 1 and result.summary.warning_kinds == ("most_left_out",)


def test_a_set_that_is_not_proven_is_said(monkeypatch):
    from bundle.graphs.pose_graphs import consistency as module

    monkeypatch.setattr(module, "largest_set", lambda given: (np.ones(len(given), bool), False))
    result = bundle.solve(graphs.loop(2), consistency=True)
    assert result.summary.warning_kinds == ("unproven_set",)


def gap(graph):
    kept = np.arange(graph.num_edges) != 4
    return graph.replace(
        edges=graph.edges[kept],
        measurements=graph.measurements[kept],
        information=graph.information[kept],
        edge_lines=graph.edge_lines[kept],
    )


def singular(graph, edge):
    information = graph.information.copy()
    information[edge, 0] = information[edge, :, 0] = 0
    return graph.replace(information=information)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (gap, "found no edge between 4 and 5"),
        (lambda g: singular(g, 3), "edge 3 4: expected invertible information"),
        (lambda g: singular(g, 12), r"edge \d+ \d+: expected invertible information"),
    ],
)
def test_graphs_that_cannot_be_checked_are_refused(change, message):
    with pytest.raises(bundle.InputError, match=rf"^consistency: .*{message}"):
        bundle.solve(change(graphs.loop(2)), consistency=True)


def test_too_many_closures_are_refused(monkeypatch):
    monkeypatch.setattr(consistency, "MOST_CLOSURES", 5)
    with pytest.raises(bundle.InputError, match=r"^consistency: expected at most 5 .* found 6"):
        bundle.solve(graphs.loop(2), consistency=True)


@pytest.mark.parametrize(("scale", "limit"), [(1e-290, 1e-12), (1e290, 1e12)])
def test_extreme_information_of_odometry_leaves_out_what_its_limit_does(scale, limit):
    graph = with_wrong_closures(certain_loop(2, num_poses=30, num_closures=20, noise=0.005), 4)

    def left_out(factor):
        scales = np.where(graph.is_closure, 1.0, factor)[:, None, None]
        scaled = graph.replace(information=scales * graph.information)
        return {one.edge: one.chi2 for one in consistency.closure_consistency(scaled).left_out}

    extreme, near = left_out(scale), left_out(limit)
    assert extreme == pytest.approx(near, rel=1e-6)
    wrong = set(range(graph.num_edges - 4, graph.num_edges))
    # Without odometry only closures between the same poses contradict each other.
    assert extreme.keys() >= wrong if scale > 1 else extreme.keys() < wrong


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_information_that_is_not_finite_is_refused(value):
    graph = graphs.loop(2)
    information = np.array(graph.information)
    information[3, 1, 1] = value
    with pytest.raises(bundle.InputError, match=r"^consistency: edge 3 4: expected invertible"):
        consistency.closure_consistency(graph.replace(information=information))


def test_scipy_is_an_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(bundle.InputError, match=r"^consistency: expected the package scipy"):
        bundle.solve(graphs.loop(2), consistency=True)


def test_the_command_names_them(tmp_path, capsys):
    from bundle.cli.main import main

    graph = with_wrong_closures(certain_loop(2, num_poses=30, num_closures=20, noise=0.005), 4)
    bundle.save(graph, tmp_path / "x.g2o")
    report = tmp_path / "r.json"
    flags = ["--consistency", "--json", str(report), "--quiet", "--verbose"]
    assert main(["refine", str(tmp_path / "x.g2o"), "-o", str(tmp_path / "y.g2o"), *flags]) == 0
    found = json.loads(report.read_text())
    assert found["options"]["consistency"] is True and found["summary"]["num_left_out_edges"] == 4
    assert {entry["line"] for entry in found["left_out_edges"]} == set(range(80, 84))
    assert all(entry["pair_chi2"] > 30 for entry in found["left_out_edges"])
    printed = capsys.readouterr().out
    assert "4 of 24 closures" in printed and " ".join(map(str, graph.edges[-1])) in printed
    assert bundle.load(tmp_path / "y.g2o").num_edges == graph.num_edges


@pytest.mark.parametrize(
    ("name", "count", "wrong_kept", "lost"), [("smallGrid3D", 50, 16, 0), ("intel", 10, 1, 0)]
)
def test_real_graphs(bundle_data, name, count, wrong_kept, lost):
    graph = bundle.load(bundle_data / "g2o" / f"{name}.g2o.bz2")
    if name == "smallGrid3D":  # its edges scatter as their information says
        assert consistency.closure_consistency(graph).left_out == ()
    found = consistency.closure_consistency(with_wrong_closures(graph, count))
    out = [entry.edge for entry in found.left_out]
    assert found.proven and sum(edge < graph.num_edges for edge in out) == lost
    assert count - len(out) + lost == wrong_kept
