"""Diagnosis of pose graphs: nullity and conditioning by dense algebra, planted weaknesses."""

import json

import numpy as np
import pytest
from scipy.stats import chi2 as chi2_distribution

import bundle
from bundle.base.tails import chi2_limit, chi2_median
from tests import scenes
from tests.graphs.pose_graphs import graphs
from tests.graphs.pose_graphs.test_wrong_closures import with_wrong_closures


def healthy(dimension, **kinds):
    """A solved loop with isotropic information that is as certain as it is right."""
    graph = graphs.loop(dimension, **kinds)
    d = graph.tangent_size
    information = np.tile(2500 * np.eye(d), (graph.num_edges, 1, 1))
    return bundle.solve(graph.replace(information=information)).problem


def with_information(graph, changes):
    information = graph.information.copy()
    for edge, matrix in changes.items():
        information[edge] = matrix
    return graph.replace(information=information)


def without_edge(graph, edge):
    parts = ("edges", "measurements", "information", "edge_lines")
    return graph.replace(**{name: np.delete(getattr(graph, name), edge, 0) for name in parts})


def dense_nullity(graph):
    jacobian = graphs.dense_jacobian(graph)[0].reshape(-1, graph.num_poses * graph.tangent_size)
    free = np.repeat(~graph.fixed, graph.tangent_size)
    values = np.linalg.svd(jacobian[:, free], compute_uv=False)
    return int(free.sum() - (values > 1e-8 * values.max()).sum())


def kinds(diagnosis):
    return [mode.kind for mode in diagnosis.weak_modes]


def test_quantiles():
    for k in range(1, 7):
        np.testing.assert_allclose(chi2_limit(k), chi2_distribution.isf(1e-6, k), rtol=1e-12)
        np.testing.assert_allclose(chi2_median(k), chi2_distribution.median(k), rtol=1e-12)
    for k in (7, 9, 15, 40):  # Wilson and Hilferty
        np.testing.assert_allclose(chi2_limit(k), chi2_distribution.isf(1e-6, k), rtol=0.05)
        np.testing.assert_allclose(chi2_median(k), chi2_distribution.median(k), rtol=0.01)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_healthy_loop(dimension):
    graph = healthy(dimension)
    found = bundle.diagnose(graph)
    d = graph.tangent_size
    assert found.ok and found.nullity == found.expected_nullity == d and not found.weak_modes
    jacobian, residual = graphs.dense_jacobian(graph)
    information = jacobian.T @ jacobian
    held = information[d:, d:]
    scale = 1 / np.sqrt(np.diag(held))
    values = np.linalg.eigvalsh(held * np.outer(scale, scale))
    np.testing.assert_allclose(found.eigenvalues, values[:4], rtol=1e-4)
    np.testing.assert_allclose(found.condition_number, values[-1] / values[0], rtol=1e-3)
    np.testing.assert_allclose(found.condition_number_unscaled, np.linalg.cond(held), rtol=1e-3)
    # The covariance of the errors of the fit, edge by edge.
    cofactor = np.eye(len(residual)) - jacobian @ np.linalg.pinv(information, 1e-10) @ jacobian.T
    for k, block in enumerate(graphs.blocks(cofactor, d)):
        values, vectors = np.linalg.eigh(block)
        seen = values > 1e-5
        along = vectors[:, seen].T @ residual[d * k : d * k + d]
        np.testing.assert_allclose(found.edge_test[k], (along**2 / values[seen]).sum(), rtol=1e-4)
        np.testing.assert_allclose(found.edge_redundancy[k], values[seen].sum(), atol=1e-6)
    total = d * (graph.num_edges - graph.num_poses + 1)
    np.testing.assert_allclose(found.edge_redundancy.sum(), total, rtol=1e-9)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_fixed_pose_takes_the_gauge(dimension):
    graph = healthy(dimension).replace(fixed=np.arange(12) == 4)
    found = bundle.diagnose(graph)
    assert found.nullity == found.expected_nullity == 0 == dense_nullity(graph)


def test_components_and_what_joins_them():
    graph = without_edge(healthy(3, num_closures=0), 5)
    found = bundle.diagnose(graph)
    assert found.nullity == found.expected_nullity == 12 == dense_nullity(graph)
    assert [part.pose_ids for part in found.components] == [tuple(range(6)), tuple(range(6, 12))]
    (mode,) = found.weak_modes
    assert mode.kind == "component" and mode.pose_ids == tuple(range(6, 12)) and not found.ok
    assert "poses 5 and 6" in mode.sentence
    one_fixed = bundle.diagnose(graph.replace(fixed=np.arange(12) == 8))
    assert one_fixed.nullity == one_fixed.expected_nullity == 6


OPEN_3D = {
    "rotation z": np.diag([1, 1, 0, 1, 1, 1.0]),
    "y": np.diag([1, 1, 1, 1, 0, 1.0]),
    "their whole relative pose": np.zeros((6, 6)),
}


@pytest.mark.parametrize("what", OPEN_3D)
def test_an_edge_without_information_is_named(what):
    graph = with_information(healthy(3, num_closures=0), {7: 2500 * OPEN_3D[what]})
    found = bundle.diagnose(graph)
    (mode,) = found.weak_modes
    assert mode.kind == "open_joint" and mode.pose_ids == (8, 9, 10, 11) and what in mode.sentence
    assert mode.edges == ((7, 8),) and mode.dimension == 6 - np.linalg.matrix_rank(OPEN_3D[what])
    assert found.nullity == 6 + mode.dimension == dense_nullity(graph) and found.nullity_is_exact
    assert np.isnan(found.edge_test).all() and np.isfinite(found.condition_number)


def test_what_hangs_on_loose_poses_moves_with_them_and_fixed_ones_stay():
    free = 2500 * np.diag([1, 1, 0, 1, 1, 1.0])
    graph = with_information(healthy(3, num_closures=0), {3: free, 7: free})
    moved = {mode.pose_ids for mode in bundle.diagnose(graph).weak_modes}
    assert moved == {(8, 9, 10, 11), (4, 5, 6, 7, 8, 9, 10, 11)}
    held = with_information(healthy(3, num_closures=0), {7: free})
    (mode,) = bundle.diagnose(held.replace(fixed=np.arange(12) == 10)).weak_modes
    assert mode.pose_ids == tuple(range(8)) and mode.dimension == 1


def test_what_several_edges_leave_open_is_counted_exactly():
    rng = np.random.default_rng(5)
    for dimension in (2, 3):
        for _ in range(3):
            seed = int(rng.integers(99))
            graph = graphs.loop(dimension, num_poses=6, num_closures=2, start_noise=0, seed=seed)
            d, changes = graph.tangent_size, {}
            for edge in rng.choice(graph.num_edges, 5, replace=False).tolist():
                seen = rng.random(d) < 0.5
                changes[edge] = np.diag(seen.astype(float))
            graph = with_information(graph, changes)
            found = bundle.diagnose(graph)
            assert found.nullity == dense_nullity(graph) and found.nullity_is_exact
            named = sum(m.dimension for m in found.weak_modes if m.kind.startswith("open"))
            assert named == found.nullity - d


def test_edges_that_complement_each_other_leave_nothing_open():
    graph = healthy(2, num_closures=0)
    graph = graph.replace(
        edges=np.concatenate([graph.edges, graph.edges[3:4]]),
        measurements=np.concatenate([graph.measurements, graph.measurements[3:4]]),
        information=np.concatenate([graph.information, 2500 * np.diag([0, 0, 1.0])[None]]),
        edge_lines=None,
    )
    found = bundle.diagnose(with_information(graph, {3: 2500 * np.diag([1.0, 1, 0])}))
    assert found.nullity == 3 and not found.weak_modes


def test_a_pose_on_a_weak_edge_is_named():
    graph = healthy(3, num_closures=0)
    weak = with_information(graph, {10: graph.information[10] * 1e-7, 4: graph.information[4] / 9})
    found = bundle.diagnose(weak)
    (mode,) = found.weak_modes
    assert mode.kind == "weak_joint" and mode.pose_ids == (11,) and mode.edges == ((10, 11),)
    assert mode.dimension == 6 and found.nullity == 6
    np.testing.assert_allclose(mode.eigenvalue, 1e-7, rtol=1e-3)
    again = healthy(3)  # in loops that others hold, a weak edge weakens nothing
    assert not bundle.diagnose(
        with_information(again, {10: 1e-7 * again.information[10]})
    ).weak_modes


def test_many_loose_clusters_are_counted_at_least():
    graph = graphs.loop(2, num_poses=120, num_closures=0, start_noise=0)
    graph = graph.replace(information=np.tile(np.diag([1.0, 1, 0]), (119, 1, 1)))
    found = bundle.diagnose(graph)
    assert not found.nullity_is_exact and found.nullity == 3 + 119


def test_wrong_closures_are_suspected_and_right_edges_are_not():
    graph = healthy(3, num_poses=40, num_closures=40, noise=0.01)
    assert bundle.diagnose(graph).suspicious_edges == ()
    solved = bundle.solve(with_wrong_closures(graph, 1))
    found = bundle.diagnose(solved)
    wrong = tuple(solved.problem.ids[solved.problem.edges[79]].tolist())
    assert found.suspicious_edges[0].edge == wrong and not found.ok
    assert found.suspicious_edges[0].test == found.edge_test[79]
    assert found.noise_scale < 2  # one wrong edge does not count as noise
    robust = bundle.diagnose(bundle.solve(with_wrong_closures(graph, 3), loss="gnc_tls"))
    assert robust.ok and np.isnan(robust.edge_test[79:]).all()
    assert "rejected_edges" in [finding.kind for finding in robust.findings]


def test_away_from_a_minimum_no_edge_is_accused():
    found = bundle.diagnose(graphs.loop(3, num_poses=20, start_noise=0.5))
    assert not found.suspicious_edges and np.isnan(found.edge_test).all()
    assert [finding.kind for finding in found.findings].count("no_minimum") == 1


def test_noise_that_the_information_denies_is_no_accusation():
    graph = healthy(2, num_poses=40, num_closures=40)
    found = bundle.diagnose(graph.replace(information=1e4 * graph.information))
    assert found.noise_scale > 1e3 and not found.suspicious_edges
    assert "optimistic_information" in [finding.kind for finding in found.findings]


def test_edges_that_rounding_hides_are_neither_accused_nor_called_unchecked():
    graph = graphs.loop(2, num_poses=60, num_closures=0, start_noise=0, noise=0)
    poses = np.zeros((60, 3))
    poses[:, 0] = 1e3 * np.arange(60)
    edges = np.concatenate([graph.edges, [[1, 3], [56, 58]]])
    steps = poses[edges[:, 1]] - poses[edges[:, 0]]
    information = np.tile(np.diag([1e6, 1e6, 1e2]), (61, 1, 1))
    long = graph.replace(
        poses=poses, edges=edges, measurements=steps, information=information, edge_lines=None
    )
    found = bundle.diagnose(long)
    assert np.isnan(found.edge_redundancy[60]) and np.isnan(found.edge_test[60])
    assert np.isfinite(found.edge_redundancy[0])
    assert "unjudged_edges" in [finding.kind for finding in found.findings]
    assert not found.suspicious_edges and found.nullity == 3


def test_edges_in_no_loop():
    graph = healthy(2, num_closures=0)
    found = bundle.diagnose(graph)
    assert not found.edge_redundancy.any() and found.ok
    assert [finding.kind for finding in found.findings] == ["unchecked_edges"]


def test_one_pose_and_all_fixed():
    graph = healthy(2)
    found = bundle.diagnose(graph.replace(fixed=np.ones(12, bool)))
    assert found.nullity == 0 and np.isnan(found.condition_number) and found.eigenvalues.size == 0
    alone = bundle.PoseGraph(
        poses=[[0, 0, 0.0]],
        edges=np.zeros((0, 2), int),
        measurements=np.zeros((0, 3)),
        information=np.zeros((0, 3, 3)),
    )
    assert bundle.diagnose(alone).nullity == 3


@pytest.mark.parametrize(
    ("name", "nullity"), [("MIT", 3), ("CSAIL", 3), ("parking-garage", 6), ("smallGrid3D", 6)]
)
def test_real_graphs_have_the_nullity_of_their_gauge(bundle_data, name, nullity):
    graph = bundle.load(bundle_data / "g2o" / f"{name}.g2o.bz2")
    found = bundle.diagnose(bundle.solve(graph, init="chordal"))
    assert found.nullity == nullity == found.expected_nullity and found.nullity_is_exact
    assert not found.weak_modes and not found.suspicious_edges and found.ok


def test_wrong_arguments():
    for arguments, name in (({"loss": "x"}, "loss"), ({"priors": [1]}, "priors")):
        with pytest.raises(bundle.InputError, match=rf"^{name}: "):
            bundle.diagnose(graphs.loop(2), **arguments)
    bad = graphs.loop(2)
    with pytest.raises(bundle.InputError, match=r"^edge 3 4: information"):
        bundle.diagnose(with_information(bad, {3: -np.eye(3)}))


def test_the_command(tmp_path, capsys):
    from bundle.cli.main import main

    graph = with_information(healthy(3, num_closures=0), {7: 2500 * np.diag([1, 1, 0, 1, 1, 1.0])})
    bundle.save(graph, tmp_path / "x.g2o")
    assert main(["diagnose", str(tmp_path / "x.g2o"), "--quiet"]) == 0
    said = capsys.readouterr().out
    assert "edge 7 8 (line 20)" in said and "rotation z" in said
    assert main(["diagnose", str(tmp_path / "x.g2o"), "--quiet", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["nullity"] == 7 and found["expected_nullity"] == 6 and found["ok"] is False
    mode = found["weak_modes"][0]
    assert mode["edges"] == [[7, 8]] and mode["image_ids"] == mode["camera_ids"] == []
    assert found["points_without_parallax"] == found["collapsed"] == []
    assert {"condition_number", "components", "digits", "suspicious_edges"} <= set(found)
    assert main(["diagnose", str(tmp_path / "x.g2o"), "--gauge", "none"]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("error: --gauge: ")


def test_what_a_graph_does_not_have_is_empty_also_in_former_pickles():
    found = bundle.diagnose(healthy(2))
    assert (found.noun, found.components[0].size) == ("pose", 12)
    assert np.isnan(found.rank_gap) and found.collapsed == ()
    state = {name: value for name, value in vars(found).items() if "points" not in name}
    old = object.__new__(bundle.GraphDiagnosis)
    old.__setstate__(state)
    for one in (found, old):
        assert one.points_seen_once.shape == (0,) and not one.points_seen_once.flags.writeable
    assert repr(old) == repr(found)
    assert bundle.diagnose(scenes.make_problem()).noun == "image"


def test_the_held_poses_of_the_condition_number_are_told():
    graph = graphs.loop(2, noise=0.0, start_noise=0.0)
    found = bundle.diagnose(graph)
    assert found.held_pose_ids == (0,)
    flags = np.zeros(graph.num_poses, bool)
    for k in (0, 6):
        fixed = bundle.diagnose(graph.replace(fixed=flags | (np.arange(graph.num_poses) == k)))
        assert fixed.held_pose_ids == ()
        same = np.isclose(fixed.condition_number, found.condition_number, rtol=1e-6)
        assert same == (k == 0)


def test_a_report_names_the_held_pose(tmp_path, capsys):
    from bundle.cli.main import main

    graph = graphs.loop(2)
    bundle.save(graph.replace(ids=np.arange(70, 70 + graph.num_poses)), tmp_path / "x.g2o")
    assert main(["diagnose", str(tmp_path / "x.g2o"), "--json", str(tmp_path / "x.json")]) == 0
    assert "70 held" in capsys.readouterr().out
    assert json.loads((tmp_path / "x.json").read_text())["held_pose_ids"] == [70]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("scale", [1e-300, 1e-150, 1e150, 1e290])
def test_condition_numbers_do_not_depend_on_the_scale_of_information(dimension, scale):
    graph = healthy(dimension)
    found = bundle.diagnose(graph)
    scaled = bundle.diagnose(graph.replace(information=scale * graph.information))
    for name in ("condition_number", "condition_number_unscaled", "eigenvalues"):
        np.testing.assert_allclose(getattr(scaled, name), getattr(found, name), rtol=1e-6)


def test_normal_equations_that_overflow_are_refused():
    graph = graphs.loop(2)
    far = np.array([1e300, 1e300, 1])
    with pytest.raises(bundle.InputError, match=r"^graph: expected normal equations"):
        bundle.diagnose(graph.replace(poses=graph.poses * far))
