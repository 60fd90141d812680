"""chi2 against its expectation: dense linear algebra, right information, seeded faults."""

import numpy as np
import pytest

import bundle
from bundle.analysis.diagnosis.chi2_kinds import information_sentence
from bundle.errors import InputError
from tests.campaigns import orderings
from tests.campaigns.triage_faults import optimistic_closure, wrong_closures
from tests.campaigns.triage_inputs import chain_of_poses


def verdicts(source, **options):
    return {one.kind: one.verdict for one in bundle.chi2_kinds(source, **options)}


def whitened_jacobian(graph):
    """The Jacobian of all edges by central differences, without the first pose."""
    step, columns = 1e-6, []
    for pose in range(1, graph.num_poses):
        for axis in range(3):
            ends = []
            for sign in (1, -1):
                poses = graph.poses.copy()
                d = np.zeros(3)
                d[axis] = sign * step
                c, s = np.cos(poses[pose, 2]), np.sin(poses[pose, 2])
                poses[pose] += [c * d[0] - s * d[1], s * d[0] + c * d[1], d[2]]
                ends.append(residuals(graph, poses))
            columns.append((ends[0] - ends[1]) / (2 * step))
    return np.array(columns).T


def residuals(graph, poses):
    from tests.campaigns.triage_inputs import relative

    a, b = poses[graph.edges[:, 0]], poses[graph.edges[:, 1]]
    error = relative(graph.measurements, relative(a, b))
    theta = error[:, 2]
    half = np.where(np.abs(theta) < 1e-9, 1.0, theta / 2 / np.tan(theta / 2 + 1e-300))
    log = np.column_stack(
        [half * error[:, 0] + theta / 2 * error[:, 1], half * error[:, 1] - theta / 2 * error[:, 0],
         theta]
    )  # fmt: skip
    roots = np.linalg.cholesky(graph.information)
    return np.einsum("eji,ej->ei", roots, log).ravel()


def test_degrees_of_freedom_are_those_of_the_projection():
    solved = bundle.solve(chain_of_poses(2, 40, 12))
    graph = solved.problem
    kinds = bundle.chi2_kinds(solved)
    found = {one.kind: one for one in kinds}
    q, _ = np.linalg.qr(whitened_jacobian(graph))
    redundancy = (1 - (q**2).sum(axis=1)).reshape(-1, 3).sum(axis=1)
    chi2 = (residuals(graph, graph.poses) ** 2).reshape(-1, 3).sum(axis=1)
    for name, rows in (("odometry", ~graph.is_closure), ("closure", graph.is_closure)):
        assert found[name].degrees == pytest.approx(redundancy[rows].sum(), rel=1e-6)
        assert found[name].chi2 == pytest.approx(chi2[rows].sum(), rel=1e-6)
        assert found[name].count == rows.sum()
    assert found["all"].degrees == pytest.approx(3 * (graph.num_edges - graph.num_poses + 1))
    factors = orderings.factors(graph)
    (alone,) = bundle.chi2_kinds(factors)
    assert alone.kind == "BetweenFactor"
    assert alone.degrees == pytest.approx(found["all"].degrees, rel=1e-9)
    assert alone.chi2 == pytest.approx(found["all"].chi2, rel=1e-9)


def test_the_interval_is_that_of_scipy():
    stats = pytest.importorskip("scipy.stats")
    for one in bundle.chi2_kinds(bundle.solve(chain_of_poses(2, 300, 60))):
        exact = stats.chi2.ppf([0.0005, 0.9995], one.degrees)
        assert (one.low, one.high) == pytest.approx(exact, rel=0.01)


def test_right_information_is_not_accused():
    """30 graphs of all shapes: walks, grids, hubs."""
    for seed in range(10):
        for graph in (
            chain_of_poses(seed, 100 + 30 * seed, 20 + 5 * seed),
            orderings.grid(seed, 6 + seed),
            orderings.hubs(seed, 150, 1 + seed % 4),
        ):
            kinds = bundle.chi2_kinds(bundle.solve(graph))
            assert information_sentence(kinds) == "", seed
            assert {one.verdict for one in kinds} <= {"as-expected", "undecided"}


@pytest.mark.parametrize(("factor", "verdict"), [
    (1 / 52, "too-cautious"), (52.0, "too-optimistic"), (1 / 1.5, "too-cautious"),
    (1.5, "too-optimistic"), (1.1, "as-expected"),
])  # fmt: skip
def test_a_common_scale_is_found(factor, verdict):
    graph = chain_of_poses(4, 900, 300)
    solved = bundle.solve(graph.replace(information=factor * graph.information))
    kinds = bundle.chi2_kinds(solved)
    assert kinds[-1].verdict == verdict
    if verdict != "as-expected":
        assert kinds[-1].scale == pytest.approx(1 / factor, rel=0.12)
        assert "all edges" in information_sentence(kinds)


def test_one_kind_is_named():
    graph = chain_of_poses(4, 900, 300)
    weights = np.where(graph.is_closure, 1 / 9, 1.0)
    solved = bundle.solve(graph.replace(information=weights[:, None, None] * graph.information))
    found = verdicts(solved)
    assert found["closure"] == "too-cautious"
    assert "closure edges" in information_sentence(bundle.chi2_kinds(solved))


def test_wrong_edges_are_no_scale():
    graph = optimistic_closure(chain_of_poses(0, 600, 100), None)
    kinds = bundle.chi2_kinds(bundle.solve(graph))
    assert {one.verdict for one in kinds} == {"too-large"}
    assert np.isnan(kinds[0].scale)
    assert "Some are wrong" in information_sentence(kinds)


def test_states_without_a_verdict():
    graph = chain_of_poses(0, 200, 40)
    assert set(verdicts(graph).values()) == {"undecided"}, "the start, no minimum"
    wrong = wrong_closures(graph, np.random.default_rng(0))
    robust = bundle.solve(wrong, loss="dcs")
    found = verdicts(robust)
    assert found["closure"] == found["all"] == "undecided"
    certain = bundle.solve(wrong, loss="gnc_tls")
    assert set(verdicts(certain).values()) == {"undecided"}
    few = verdicts(bundle.solve(chain_of_poses(0, 30, 2)))
    assert set(few.values()) == {"undecided"}
    with pytest.raises(InputError, match="source: expected a graph"):
        bundle.chi2_kinds(3)
    with pytest.raises(InputError, match="options: expected only"):
        bundle.chi2_kinds(orderings.factors(graph), error="g2o")


def test_kinds_of_factors():
    walk = bundle.solve(chain_of_poses(1, 120, 40)).problem
    graph = orderings.factors(walk)
    rng = np.random.default_rng(0)
    for k in range(2, 120, 2):
        noise = rng.standard_normal(3) * [0.1, 0.1, 0.03]
        weight = 52 * np.diag([1 / 0.1, 1 / 0.1, 1 / 0.03]) ** 2
        graph.add_factor(bundle.PriorFactor(k, walk.poses[k] + noise, weight))
    solved = graph.with_values(graph.solve(function_tolerance=1e-14).values)
    kinds = bundle.chi2_kinds(solved)
    found = {one.kind: one for one in kinds}
    assert set(found) == {"BetweenFactor", "PriorFactor", "all"}
    rows = 3 * len(graph.factors)
    assert found["all"].degrees == pytest.approx(rows - 3 * 119, rel=1e-9)
    assert found["PriorFactor"].chi2 > 5 * found["PriorFactor"].degrees
    assert information_sentence(kinds, "factor")


@pytest.mark.parametrize(("name", "verdict", "scale"), [
    ("intel", "too-cautious", 52.33), ("smallGrid3D", "as-expected", 1.0),
    ("MIT", "as-expected", 1.0),
])  # fmt: skip
def test_real_graphs(bundle_data, name, verdict, scale):
    kinds = bundle.chi2_kinds(bundle.solve(bundle_data / "g2o" / f"{name}.g2o.bz2"))
    assert (kinds[-1].kind, kinds[-1].verdict) == ("all", verdict)
    assert kinds[-1].scale == pytest.approx(scale, rel=1e-3)
    if name == "intel":
        assert (kinds[-1].chi2, kinds[-1].degrees) == pytest.approx((45.0042330881, 2355))
        assert "52.33 times too cautious" in information_sentence(kinds)
