"""Diagnosis of factor graphs: the same problem both ways, planted defects, decoys."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.analysis.factor_equations import diagnose_factor_graph
from tests.analysis.uncertainty.test_factor_graph_covariance import landmarks, scene
from tests.graphs.factors import both_ways
from tests.graphs.pose_graphs import graphs

NUMBERS = (
    *("nullity", "expected_nullity", "condition_number", "condition_number_unscaled"),
    *("eigenvalues", "edge_redundancy", "edge_test", "noise_scale"),
)


def solved(dimension, **kinds):
    return bundle.solve(graphs.loop(dimension, **kinds)).problem


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("name", [int, lambda key: f"x{key}"])
def test_a_pose_graph_has_the_diagnosis_of_its_file(dimension, name, tmp_path):
    graph = solved(dimension, num_poses=14, num_closures=5)
    information = graph.information.copy()
    information[3] *= 100.0  # a suspicious edge
    graph = graph.replace(information=information, fixed=np.arange(14) == 0)
    bundle.save(graph, tmp_path / "x.g2o")
    theirs = bundle.diagnose(tmp_path / "x.g2o")
    ours = bundle.diagnose(both_ways.of_pose_graph(graph, name))
    for number in NUMBERS:
        np.testing.assert_allclose(getattr(ours, number), getattr(theirs, number), rtol=1e-9)
    assert [part.pose_ids for part in ours.components] == [
        tuple(name(key) for key in part.pose_ids) for part in theirs.components
    ]
    assert [finding.kind for finding in ours.findings] == [
        finding.kind for finding in theirs.findings
    ]


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_jacobian_alone_gives_the_same_numbers(dimension):
    graph = solved(dimension, num_poses=14, num_closures=5)
    for key in (4, 9):
        graph = graph.replace(fixed=np.arange(14) == key)
        theirs = bundle.diagnose(graph)
        ours = diagnose_factor_graph(both_ways.of_pose_graph(graph), 1)
        for number in NUMBERS:
            close = 1e-4 if number.startswith(("condition", "eigen")) else 1e-9
            np.testing.assert_allclose(getattr(ours, number), getattr(theirs, number), rtol=close)
        assert ours.ok == theirs.ok


def test_reprojections_have_the_diagnosis_of_their_problem():
    problem = scene()
    graph = both_ways.of_problem(problem, held=(1, 2))
    # a graph normalises quaternions, which changes their last digits
    poses = [graph.values["image", key] for key in problem.image_ids.tolist()]
    problem = problem.replace(cam_from_world=np.array(poses))
    theirs = bundle.diagnose(problem, cheirality="algebraic")
    ours = bundle.diagnose(graph)
    for field in dataclasses.fields(theirs):
        np.testing.assert_equal(getattr(ours, field.name), getattr(theirs, field.name))
    by_jacobian = diagnose_factor_graph(graph, 1)
    assert by_jacobian.nullity == ours.nullity == by_jacobian.expected_nullity == 7


def with_open(*names):
    graph = landmarks()
    for k, name in enumerate(names):
        graph.add_variable(name, [3.0 + k, 2.0])
        graph.add_factor(
            bundle.LinearPrior(np.diag([1.0, 0.0]), [0.1, 0.0], {name: [3.0, 2.0]}, (name,))
        )
    return graph


def test_what_no_factor_determines_is_named_by_key():
    found = bundle.diagnose(with_open("ghost", "spook"))
    assert (found.nullity, found.expected_nullity) == (5, 3) and not found.ok
    modes = [mode for mode in found.weak_modes if mode.kind == "open_direction"]
    assert sorted(mode.pose_ids for mode in modes) == [("ghost",), ("spook",)]
    assert "2 are not determined" in found.verdict
    assert all("'ghost'" in mode.sentence or "'spook'" in mode.sentence for mode in modes)
    assert np.isnan(found.edge_test).all()


def test_a_healthy_graph_has_a_gauge_only():
    graph = landmarks()
    values = graph.solve().values
    found = bundle.diagnose(graph.with_values(values))
    assert found.nullity == found.expected_nullity == 3
    assert [mode.kind for mode in found.weak_modes] == ["component"] and found.ok
    assert [len(part.pose_ids) for part in found.components] == [6, 4]
    assert found.verdict.endswith("all of them gauge")


def test_a_weak_prior_is_a_weak_direction_and_a_long_chain_is_none():
    def chain(count, sigma):
        graph = bundle.FactorGraph()
        for k in range(count):
            graph.add_variable(k, [float(k), 0, 0], "se2")
        for k in range(count - 1):
            graph.add_factor(bundle.BetweenFactor(k, k + 1, [1, 0, 0], 1e4))
        graph.add_factor(bundle.PriorFactor(0, [0, 0, 0], 1 / sigma**2))
        return graph

    weak = bundle.diagnose(chain(30, 1e4))
    kinds = [mode.kind for mode in weak.weak_modes]
    assert kinds.count("weak_direction") == 3 and weak.nullity == 0 and not weak.ok
    healthy = bundle.diagnose(chain(300, 0.01))
    assert healthy.nullity == 0 and not healthy.weak_modes and healthy.ok


def test_a_wrong_factor_is_named_and_right_ones_are_not():
    rng = np.random.default_rng(11)
    graph = bundle.FactorGraph()
    truth = rng.normal(size=(12, 3))
    for k in range(12):
        graph.add_variable(f"p{k}", truth[k])
    pairs = [(a, b) for a in range(12) for b in range(a + 1, 12) if (a + b) % 3]
    for k, (a, b) in enumerate(pairs):
        error = 0.1 * rng.normal(size=3) + (2.0 if k == 17 else 0.0)
        graph.add_factor(bundle.BetweenFactor(f"p{a}", f"p{b}", truth[b] - truth[a] + error, 100.0))
    graph = graph.with_values(graph.solve().values)
    found = bundle.diagnose(graph)
    a, b = pairs[17]
    assert found.suspicious_edges[0].edge == (f"p{a}", f"p{b}")
    assert found.nullity == found.expected_nullity == 3
    assert any(f"factor 17, BetweenFactor('p{a}', 'p{b}')" in f.sentence for f in found.findings)
    better = bundle.FactorGraph()
    for key, variable in graph.variables.items():
        better.add_variable(key, variable.value)
    for k, factor in enumerate(graph.factors):
        if k != 17:
            better.add_factor(factor)
    right = bundle.diagnose(better.with_values(better.solve().values))
    assert not right.suspicious_edges and right.ok
    moved = bundle.diagnose(graph.with_values({"p3": [9.0, 9, 9]}))
    assert "no_minimum" in [finding.kind for finding in moved.findings]
    assert np.isnan(moved.edge_test).all()


def test_nothing_to_diagnose_is_one_line():
    with pytest.raises(bundle.InputError, match=r"^graph: expected at least one variable"):
        bundle.diagnose(bundle.FactorGraph())
    with pytest.raises(bundle.InputError, match=r"^loss: expected only with a reconstruction"):
        bundle.diagnose(landmarks(), loss="huber")


def test_held_keys_are_those_of_the_pose_graph():
    graph = solved(2)
    free = bundle.FactorGraph()
    for k, pose in enumerate(graph.poses):
        free.add_variable(f"x{k}", pose, "se2")
    for (a, b), z, omega in zip(graph.edges, graph.measurements, graph.information, strict=True):
        free.add_factor(bundle.BetweenFactor(f"x{a}", f"x{b}", z, omega))
    stated, by_jacobian = bundle.diagnose(free), diagnose_factor_graph(free)
    assert stated.held_pose_ids == by_jacobian.held_pose_ids == ("x0",)
    assert "'x0' held" in repr(stated)


@pytest.mark.parametrize("scale", [1e-300, 1e290])
def test_condition_numbers_of_factors_do_not_depend_on_their_scale(scale):
    def chain(information):
        graph = bundle.FactorGraph()
        for k in range(4):
            graph.add_variable(k, [float(k), 0.0])
        graph.add_factor(bundle.PriorFactor(0, [0, 0], information))
        for k in range(3):
            graph.add_factor(bundle.BetweenFactor(k, k + 1, [1, 0], information))
        return bundle.diagnose(graph)

    found, scaled = chain(1.0), chain(scale)
    for name in ("condition_number", "condition_number_unscaled", "eigenvalues"):
        np.testing.assert_allclose(getattr(scaled, name), getattr(found, name), rtol=1e-6)
