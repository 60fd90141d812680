"""Losses for wrong closures: their formulae, and what they find in graphs with some."""

import json

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.stats import chi2 as chi2_distribution

import bundle
from bundle import _core
from bundle.base.tails import ONE_IN_2000, ONE_IN_A_MILLION
from bundle.graphs.pose_graphs.gnc_solve import graduate, tls_weights
from tests.graphs.pose_graphs import graphs

LOSSES = ["geman_mcclure", "switchable", "dcs", "gnc_tls"]


def with_wrong_closures(graph, count, seed=1):
    """Add closures between random poses, measured at random, as certain as the right ones."""
    rng = np.random.default_rng(seed)
    place = graph.poses[:, :2] if graph.dimension == 2 else graph.poses[:, 4:]
    spread = np.ptp(place, axis=0) / 4
    edges, measured = [], []
    while len(edges) < count:
        i, j = sorted(rng.choice(graph.num_poses, 2, replace=False).tolist())
        if j - i < 2:
            continue
        edges.append((i, j))
        far = rng.uniform(-1, 1, len(spread)) * spread
        if graph.dimension == 2:
            measured.append([*far, rng.uniform(-np.pi, np.pi)])
        else:
            turn = Rotation.random(random_state=int(rng.integers(1 << 30))).as_quat()
            measured.append([*turn, *far])
    information = np.median(graph.information, axis=0)
    return graph.replace(
        edges=np.concatenate([graph.edges, edges]),
        measurements=np.concatenate([graph.measurements, measured]),
        information=np.concatenate([graph.information, np.tile(information, (count, 1, 1))]),
        edge_lines=np.zeros(graph.num_edges + count, int),
    )


def certain_loop(dimension, **kinds):
    """A loop whose edges are as certain as they are right, to about a hundredth."""
    graph = graphs.loop(dimension, start_noise=0, **kinds)
    return graph.replace(information=1000 * graph.information)


def distance(one, other):
    parts = slice(0, 2) if one.dimension == 2 else slice(4, 7)
    return np.linalg.norm(one.poses[:, parts] - other.poses[:, parts], axis=1).max()


def test_quantiles():
    for d in (3, 6):
        np.testing.assert_allclose(ONE_IN_2000[d], chi2_distribution.ppf(0.9995, d), rtol=1e-12)
        np.testing.assert_allclose(ONE_IN_A_MILLION[d], chi2_distribution.isf(1e-6, d), rtol=1e-12)


@pytest.mark.parametrize("x", [0.0, 0.5, 3.9, 4.1, 100.0])
def test_losses_come_from_switches(x):
    """b = 4: rho is what the best switch leaves, rho' its square, and rho the integral of rho'."""
    switches = np.linspace(0, 1, 200_001)
    left = (switches**2 * x + 4 * (1 - switches) ** 2).min()
    for name in ("geman_mcclure", "switchable"):
        rho = _core.edge_loss(name, 2.0, x)
        np.testing.assert_allclose(rho[0], left, rtol=1e-9)
        np.testing.assert_allclose(rho[1], (4 / (4 + x)) ** 2, rtol=1e-14)
    dcs = _core.edge_loss("dcs", 2.0, x)
    np.testing.assert_allclose(dcs[1], min(1, 8 / (4 + x)) ** 2, rtol=1e-14)
    for name in ("geman_mcclure", "dcs", "cauchy"):
        area = quad(lambda t, n=name: _core.edge_loss(n, 2.0, t)[1], 0, x, points=[4.0])[0]
        np.testing.assert_allclose(_core.edge_loss(name, 2.0, x)[0], area, rtol=1e-9, atol=1e-15)
        slope = (_core.edge_loss(name, 2.0, x + 1e-5)[1] - _core.edge_loss(name, 2.0, x)[1]) / 1e-5
        np.testing.assert_allclose(_core.edge_loss(name, 2.0, x)[2], slope, rtol=1e-4, atol=1e-12)


def test_weights_of_the_truncated_loss_are_the_best():
    """Against a search over w of w x + mu (1 - w) / (mu + w) c^2."""
    grid = np.linspace(0, 1, 100_001)
    x = np.array([0.0, 1, 5, 9, 11, 20, 300])
    for mu in (0.01, 0.5, 3.0):
        cost = grid * x[:, None] + mu * (1 - grid) / (mu + grid) * 10
        np.testing.assert_allclose(tls_weights(x, mu, 10), grid[cost.argmin(1)], atol=2e-5)


def test_graduation_leaves_trusted_edges_alone_and_ends_with_in_or_out():
    chi2 = np.array([1.0, 500, 700, 3, 900])
    doubted = np.array([True, True, False, True, True])
    seen = []

    def solve(weights):
        seen.append(weights.copy())
        return chi2

    weights, count = graduate(chi2, doubted, 10.0, solve)
    assert weights.tolist() == [1, 0, 1, 1, 0] and count == len(seen) > 1
    assert all(found[2] == 1 for found in seen)
    mu = 10 / (2 * 900 - 10)  # of the paper, with its factor of 1.4 from one solve to the next
    for found in seen:
        soft = np.sqrt(10 * mu * (mu + 1) / chi2) - mu
        np.testing.assert_allclose(found[doubted], np.clip(soft, 0, 1)[doubted])
        mu *= 1.4
    assert graduate(chi2 / 100, doubted, 10.0, solve)[1] == 0  # nothing to doubt


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("loss", LOSSES)
def test_wrong_closures_are_found_and_named(dimension, loss):
    graph = certain_loop(dimension, num_poses=40, num_closures=40, noise=0.005)
    clean = bundle.solve(graph)
    bad = with_wrong_closures(graph, 8)
    result = bundle.solve(bad, loss=loss, loss_scale=1.0 if loss == "gnc_tls" else 3.0)
    assert sorted(result.rejected) == list(range(79, 87))
    assert list(result.chi2_after[list(result.rejected)]) == sorted(
        result.chi2_after[79:], reverse=True
    )
    assert result.summary.num_rejected_edges == 8
    assert distance(result.problem, clean.problem) < 0.2 * distance(
        bundle.solve(bad).problem, clean.problem
    )
    assert (result.weights[:39] == 1).all() and (result.weights[79:] < 0.5).all()
    if loss == "gnc_tls":
        assert distance(result.problem, clean.problem) < 1e-5
        c_squared = ONE_IN_2000[graph.tangent_size]
        truncated = np.minimum(result.chi2_after[39:], c_squared).sum()
        cost = (result.chi2_after[:39].sum() + truncated) / 2
        np.testing.assert_allclose(result.summary.final_cost, cost, rtol=1e-12)
    np.testing.assert_allclose(result.summary.chi2_final, result.chi2_after.sum(), rtol=1e-12)
    np.testing.assert_array_equal(result.problem.information, bad.information)


def test_without_a_loss_nothing_is_rejected():
    result = bundle.solve(with_wrong_closures(graphs.loop(2), 3))
    assert result.rejected == () and (result.weights == 1).all()


def test_all_closures_may_be_rejected():
    graph = with_wrong_closures(certain_loop(2, num_closures=0, noise=0), 5)
    for loss in LOSSES:
        result = bundle.solve(graph, loss=loss)
        assert len(result.rejected) == 5 and result.summary.is_solution_usable
    np.testing.assert_allclose(result.problem.poses, graph.poses, atol=1e-9)


@pytest.mark.parametrize("loss", ["geman_mcclure", "dcs", "switchable"])
def test_ceres_has_none_of_these(loss):
    with pytest.raises(bundle.InputError, match=r"^backend: expected auto or fused"):
        bundle.solve(graphs.loop(2), loss=loss, backend="ceres")


def test_gnc_is_stopped_by_its_user():
    calls = []

    def progress(record):
        calls.append(record)
        if len(calls) == 4:
            raise KeyboardInterrupt

    graph = with_wrong_closures(graphs.loop(2), 3)
    result = bundle.solve(graph, loss="gnc_tls", progress=progress)
    assert result.summary.interrupted and len(calls) == 4


def test_the_command_names_them(tmp_path, capsys):
    from bundle.cli.main import main

    graph = with_wrong_closures(certain_loop(2, num_poses=30, num_closures=20, noise=0.005), 4)
    bundle.save(graph, tmp_path / "x.g2o")
    report = tmp_path / "r.json"
    flags = ["--loss", "gnc-tls", "--json", str(report), "--quiet", "--verbose"]
    assert main(["refine", str(tmp_path / "x.g2o"), "-o", str(tmp_path / "y.g2o"), *flags]) == 0
    rejected = json.loads(report.read_text())["rejected_edges"]
    assert sorted(entry["edge"] for entry in rejected) == sorted(graph.edges[49:].tolist())
    assert {entry["line"] for entry in rejected} == set(range(80, 84))
    assert all(entry["weight"] == 0 and entry["chi2"] > 17 for entry in rejected)
    assert "4 edges" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "count", "loss"),
    [
        ("intel", 10, "gnc_tls"),
        ("intel", 100, "gnc_tls"),
        ("smallGrid3D", 50, "gnc_tls"),
    ],
)
def test_real_graphs_end_within_a_centimetre_of_the_clean_optimum(bundle_data, name, count, loss):
    graph = bundle.load(bundle_data / "g2o" / f"{name}.g2o.bz2")
    clean = bundle.solve(graph)
    result = bundle.solve(with_wrong_closures(graph, count), loss="auto")
    assert result.summary.loss == loss
    assert distance(result.problem, clean.problem) < 0.01
    assert sorted(result.rejected) == list(range(graph.num_edges, graph.num_edges + count))
