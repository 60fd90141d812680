"""Certificates of pose graphs: published optima, dense oracles, planted minima, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import bundle
from bundle.graphs.pose_graphs.certify import _run, bound_weights, chordal_weights
from tests.graphs.pose_graphs.chordal_oracle import (
    certificate_eigenvalues,
    chordal_cost,
    join,
    ring,
    split,
)
from tests.graphs.pose_graphs.graphs import random_information, random_pose

# F* with mean weights; first positive eigenvalue, translations eliminated, and of S itself; F* with
# SE-Sync's weights: by NumPy and SciPy, verified by independent code
OPTIMA = {
    "tinyGrid3D": (18.5193664, 4.71081, 3.33857, None),
    "smallGrid3D": (1025.39806, 4.17404, 1.96306, 1025.39806),
    "parking-garage": (1.28193204, 6.63703e-4, 3.48181e-7, 1.26252),
    "sphere2500": (2179.39800, 0.590697, 2.47529e-3, 1687.00581),
    "intel": (52.8000113, 0.0279429, 1.30630e-3, 52.3482273),
    "MIT": (46.1076098, 0.0204736, 7.21850e-6, 61.1541155),
    "CSAIL": (376.479838, 0.387378, 4.99515e-3, 31.7037159),
    "M3500": (137.908903, 2.72965e-3, 1.55359e-5, 193.862258),
}


@pytest.mark.parametrize("name", OPTIMA)
def test_public_graphs_are_certified(bundle_data, name):
    cost, eliminated, explicit, of_se_sync = OPTIMA[name]
    graph = bundle.load(bundle_data / f"g2o/{name}.g2o.bz2")
    solved = bundle.solve(graph)
    found = bundle.certify(solved)
    assert found.verdict == "certified"
    assert found.cost == pytest.approx(cost, rel=1e-8)
    assert found.eigenvalues[0] == pytest.approx(eliminated, rel=1e-5)
    assert abs(found.min_eigenvalue) < 8e-9
    assert 0 <= found.gap < 1e-5 * cost
    assert found.staircase is None
    whole = _run(solved.problem, chordal_weights(graph, "mean", "log"), 0, 1, explicit=True)
    assert whole["eigenvalues"][0] == pytest.approx(explicit, rel=1e-5)
    # a lower bound of chi2, near it where the information is isotropic
    assert 0 < found.chi2_lower_bound <= found.chi2 == pytest.approx(solved.summary.chi2_final)
    if of_se_sync is not None:
        other = bundle.certify(solved, weights="se-sync")
        assert other.verdict == "certified"
        assert other.cost == pytest.approx(
            of_se_sync, rel=1e-5 if name == "parking-garage" else 1e-8
        )


@pytest.mark.parametrize(
    ("name", "cost", "eigenvalues", "bound", "optimum"),
    [
        ("MIT_critical_file", 779.420975, [-7.66147, -6.30039, -5.44779], -11601.5, 46.1076098),
        ("ring2d_wound", 195.326717, [-4.97767282], None, 0.0510166294),
    ],
)
def test_known_local_minima_are_not_certified(bundle_data, name, cost, eigenvalues, bound, optimum):
    found = bundle.certify(bundle.load(bundle_data / f"g2o/{name}.g2o"))
    assert found.verdict == "not-certified"
    assert found.cost == pytest.approx(cost, rel=1e-8)
    assert found.eigenvalues[: len(eigenvalues)] == pytest.approx(eigenvalues, rel=1e-5)
    assert found.min_eigenvalue == found.eigenvalues[0]
    if bound is not None:
        assert found.lower_bound == pytest.approx(bound, rel=1e-5)
    assert found.gap == pytest.approx(found.cost - max(found.lower_bound, 0))
    # the staircase leaves them
    assert found.staircase.verdict == "certified"
    assert found.staircase.cost == pytest.approx(optimum, rel=1e-8)
    assert found.staircase.rank > found.problem.dimension


def test_ring_without_noise_has_the_eigenvalue_of_the_closed_form():
    kappa, size = 50.0, 20
    step = 1 - np.cos(2 * np.pi / size)
    wound = ring(np.random.default_rng(0), size, 2, kappa=kappa, noise=0.0, turns=1)
    found = bundle.certify(bundle.solve(wound, init="file"), max_rank=0)
    assert found.verdict == "not-certified"
    assert found.cost == pytest.approx(4 * size * kappa * step, rel=1e-9)
    assert found.min_eigenvalue == pytest.approx(-2 * kappa * step, rel=1e-9)
    for many, dimension in ((3, 3), (size, 2), (500, 2), (500, 3)):
        true = bundle.certify(ring(np.random.default_rng(0), many, dimension, noise=0.0))
        assert (true.verdict, true.staircase) == ("certified", None)
        assert true.gap <= true.cost < 1e-20
    tiny = bundle.solve(ring(np.random.default_rng(0), 500, 2, noise=1e-6))
    assert bundle.certify(tiny).verdict == "certified"


@pytest.mark.parametrize("seed", range(8))
def test_eigenvalues_are_those_of_dense_matrices(seed):
    rng = np.random.default_rng(seed)
    graph = _random_graph(rng, 2 + seed % 2, size=int(rng.integers(2, 12)))
    weights = chordal_weights(graph, "mean", "log")
    found = _run(graph, weights, 0, 1)
    whole = _run(graph, weights, 0, 1, explicit=True)
    there = graph.replace(poses=found["poses"])
    eliminated, explicit = certificate_eigenvalues(there, weights.kappa, weights.tau)
    assert found["cost"] == pytest.approx(chordal_cost(there, weights.kappa, weights.tau), rel=1e-9)
    scale = max(weights.kappa.max(), 1e-9)
    for values, mine, zeros in (
        (eliminated, found["eigenvalues"], graph.dimension),
        (explicit, whole["eigenvalues"], graph.dimension + 1),
    ):
        # without the null space of X, and of the translation
        order = np.argsort(np.abs(values))
        rest = np.sort(np.delete(values, order[:zeros]))
        assert np.abs(values[order[:zeros]]).max() < 1e-8 * np.abs(values).max()
        count = min(len(mine), len(rest))
        assert count > 0 or graph.num_poses == 2
        assert mine[:count] == pytest.approx(rest[:count], rel=1e-8, abs=1e-9 * scale)


@pytest.mark.parametrize("seed", range(24))
def test_tiny_graphs_lose_no_eigenvalue(seed):
    """A search space of all dimensions has all eigenvalues, negative ones above all."""
    rng = np.random.default_rng(seed)
    dimension, size = 2 + seed % 2, 3 + seed % 3
    graph = _random_graph(rng, dimension, size=size)
    turned = graph.replace(poses=np.array([_moved(rng, pose, 2.0) for pose in graph.poses]))
    weights = chordal_weights(graph, "mean", "log")
    found = _run(turned, weights, 0, 1)
    there = turned.replace(poses=found["poses"])
    values, _ = certificate_eigenvalues(there, weights.kappa, weights.tau)
    order = np.argsort(np.abs(values))
    rest = np.sort(np.delete(values, order[:dimension]))
    assert len(found["eigenvalues"]) == min(3, len(rest))
    assert found["eigenvalues"] == pytest.approx(
        rest[:3], rel=1e-6, abs=1e-9 * np.abs(values).max()
    )


def test_the_staircase_ends_where_nothing_changes(bundle_data):
    """In a flat valley hundreds of steps and further ranks would not lower F."""
    solved = bundle.solve(bundle.load(bundle_data / "g2o/manhattan_b.g2o.bz2"))
    steps = []
    found = bundle.certify(solved, progress=steps.append)
    assert found.verdict == "not-certified" and found.staircase.rank == 3
    assert found.cost == pytest.approx(2045.05394, rel=1e-8)
    assert found.lower_bound == pytest.approx(2031.7493, rel=1e-6)
    assert found.staircase.relaxed_cost <= found.cost
    assert len(steps) < 40
    assert found.staircase.lower_bound >= found.lower_bound


@pytest.mark.parametrize("seed", range(50))
def test_true_optima_and_planted_minima_get_the_right_verdict(seed):
    rng = np.random.default_rng(seed)
    dimension, turns = 2 + seed % 2, (0, 1)[(seed // 2) % 2]
    size = int(rng.integers(8, 40))
    weights = {"kappa": 10 ** rng.uniform(0, 4), "tau": 10 ** rng.uniform(-2, 4)}
    noise = rng.uniform(0, 0.05)

    def solved(turns):
        graph = ring(
            np.random.default_rng(seed), size, dimension, noise=noise, turns=turns, **weights
        )
        return bundle.solve(graph, init="file", max_num_iterations=500)

    optimum = bundle.certify(solved(0))
    assert optimum.verdict == "certified"
    assert optimum.cost - optimum.gap <= optimum.chi2_lower_bound + 1e-9 * optimum.cost
    if turns:
        wound = solved(turns)
        planted = bundle.certify(wound)
        if wound.summary.termination_type != "CONVERGENCE":
            assert planted.verdict != "certified"
            return
        # in space some unwind in the solve
        is_optimum = planted.cost == pytest.approx(optimum.cost, rel=1e-6)
        assert planted.verdict == ("certified" if is_optimum else "not-certified")
        assert dimension == 3 or not is_optimum
        assert planted.chi2 >= planted.chi2_lower_bound
        if not is_optimum:
            assert planted.min_eigenvalue < 0
            assert planted.lower_bound < optimum.cost < planted.cost
            assert planted.staircase.verdict == "certified"
            assert planted.staircase.cost == pytest.approx(optimum.cost, rel=1e-6)


def test_bounds_hold_at_any_poses():
    """F and chi2 at random poses, by NumPy, are above the bounds; F <= chi2 for every error."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        graph = _random_graph(rng, 2 + seed % 2, size=5, isotropic=seed % 3 == 0)
        for error in ("log", "g2o", "ceres"):
            found = bundle.certify(graph, error=error)
            mean = chordal_weights(graph, "mean", error)
            below = bound_weights(graph, error)
            bounds = [found.lower_bound]
            if found.staircase is not None:
                bounds.append(found.staircase.lower_bound)
            for size in (0.01, 0.3, 3.0):
                poses = np.array([_moved(rng, pose, size) for pose in found.problem.poses])
                there = graph.replace(poses=poses)
                assert chordal_cost(there, mean.kappa, mean.tau) >= max(bounds) * (1 - 1e-12)
                chi2 = bundle.pose_graph_chi2(there, error).sum()
                assert chordal_cost(there, below.kappa, below.tau) <= chi2 * (1 + 1e-12)
                assert chi2 >= found.chi2_lower_bound * (1 - 1e-12)


def test_isotropic_information_in_space_has_the_chi2_of_g2o_and_ceres():
    graph = _random_graph(np.random.default_rng(3), 3, size=6, isotropic=True)
    for error in ("g2o", "ceres"):
        found = bundle.certify(graph, error=error, max_rank=0)
        assert found.is_isotropic
        assert found.initial_cost == pytest.approx(found.chi2, rel=1e-10)


@pytest.mark.parametrize("dimension", [2, 3])
def test_isotropic_information_is_that_of_the_means_of_the_diagonals(dimension):
    graph = _random_graph(np.random.default_rng(4), dimension, size=6)
    half = 2 if dimension == 2 else 3
    means = np.diagonal(graph.information, axis1=1, axis2=2).copy()
    for part in (means[:, :half], means[:, half:]):
        part[:] = part.mean(axis=1, keepdims=True)
    means = means[:, :, None] * np.eye(means.shape[1])
    expected = bundle.certify(graph.replace(information=means))
    found = bundle.certify(graph, information="isotropic")
    assert found.is_isotropic and not bundle.certify(graph).is_isotropic
    for name in ("cost", "initial_cost", "lower_bound", "chi2", "chi2_lower_bound"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-9), name
    np.testing.assert_array_equal(found.problem.information, graph.information)


def test_certificate_does_not_depend_on_order_frame_or_units():
    rng = np.random.default_rng(5)
    for dimension in (2, 3):
        wound = ring(rng, 16, dimension, turns=1, noise=0.01, chords=1)
        for graph in (bundle.solve(wound, init="file").problem, bundle.solve(wound).problem):
            found = bundle.certify(graph)
            order = rng.permutation(graph.num_poses)
            place = np.argsort(order)
            r, t = split(random_pose(rng, dimension, size=1e6))
            moved = [join(r @ a, r @ b + t) for a, b in map(split, graph.poses)]
            flipped = rng.permutation(graph.num_edges)
            other = bundle.certify(
                bundle.PoseGraph(
                    poses=np.array(moved)[order],
                    edges=place[graph.edges[flipped]].astype(np.int32),
                    measurements=graph.measurements[flipped],
                    information=100 * graph.information[flipped],
                )
            )
            assert other.verdict == found.verdict
            assert other.cost == pytest.approx(100 * found.cost, rel=1e-5)
            if found.verdict == "not-certified":
                expected = 100 * found.min_eigenvalue
                assert other.min_eigenvalue == pytest.approx(expected, rel=1e-5)


def test_poses_that_are_no_minimum_get_no_certificate(bundle_data):
    for name in ("tinyGrid3D", "M3500", "MIT", "intel", "parking-garage"):
        graph = bundle.load(bundle_data / f"g2o/{name}.g2o.bz2")
        assert bundle.certify(graph, max_rank=0).verdict == "not-a-minimum", name
    # a saddle: a ring whose poses fold back exactly
    graph = ring(np.random.default_rng(0), 2, 2, noise=0.0)
    half = graph.replace(poses=np.array([[0, 0, 0], [0, 0, 0]], float))
    assert bundle.certify(half).verdict != "certified" or bundle.certify(half).cost < 1e-12


@pytest.mark.parametrize(("noise", "verdict"), [(0.4, "certified"), (0.9, "not-certified")])
def test_large_noise_makes_the_relaxation_loose_and_no_verdict_wrong(noise, verdict):
    for seed in range(4):
        graph = ring(np.random.default_rng(seed), 8, 3, noise=noise, chords=4)
        found = bundle.certify(bundle.solve(graph, max_num_iterations=500))
        assert found.verdict == verdict
        best = min(
            bundle.certify(bundle.solve(_shaken(graph, k), init="file"), max_rank=0).cost
            for k in range(4)
        )
        if verdict == "certified":
            assert found.cost <= best * (1 + 1e-6)
        else:
            assert found.staircase.relaxed_cost >= found.staircase.lower_bound * (1 - 1e-9)
            assert found.lower_bound < found.staircase.lower_bound <= best * (1 + 1e-9)


def test_solve_leaves_a_local_minimum_and_says_so(bundle_data):
    graph = bundle.load(bundle_data / "g2o/MIT.g2o.bz2")
    solved = bundle.solve(graph, init="file", certify=True)
    assert solved.certificate.verdict == "not-certified"
    assert solved.certificate.chi2 == pytest.approx(770.239, rel=1e-5)
    assert solved.summary.chi2_final == pytest.approx(41.2069470415, rel=1e-8)
    assert solved.summary.init == "staircase"
    assert solved.initial_problem is graph
    assert solved.options.init == "file"
    straight = bundle.solve(graph, certify=True)
    assert straight.certificate.verdict == "certified"
    assert straight.summary.chi2_final == pytest.approx(41.2069470415, rel=1e-8)
    assert bundle.solve(graph).certificate is None


def _two_pieces():
    graph = ring(np.random.default_rng(0), 8, 2)
    return graph.replace(
        edges=np.where(graph.edges == 7, 6, graph.edges)[[0, 1, 2, 3, 4, 5]],
        measurements=graph.measurements[:6],
        information=graph.information[:6],
        edge_lines=graph.edge_lines[:6],
    )


def test_bad_input_is_refused_with_the_reason():
    graph = ring(np.random.default_rng(0), 8, 2)
    information = np.array(graph.information)
    information[3] = 0
    empty = {
        "edges": np.zeros((0, 2), np.int32),
        "measurements": np.zeros((0, 3)),
        "information": np.zeros((0, 3, 3)),
        "edge_lines": np.zeros(0, np.int64),
    }
    fixed = np.zeros(8, bool)
    fixed[[2, 5]] = True
    refused = {
        "connected": _two_pieces(),
        "edge 3 4.*weights above 0": graph.replace(information=information),
        "at least one edge": graph.replace(**empty),
        "at most 1 fixed pose": graph.replace(fixed=fixed),
    }
    for message, bad in refused.items():
        with pytest.raises(bundle.InputError, match=message):
            bundle.certify(bad)
        with pytest.raises(bundle.InputError, match=message):
            bundle.solve(bad, certify=True)
    with pytest.raises(bundle.InputError, match="certify: expected no loss, found huber"):
        bundle.solve(graph, certify=True, loss="huber")
    with pytest.raises(bundle.InputError, match="certify: expected no loss, found cauchy"):
        bundle.certify(bundle.solve(graph, loss="cauchy"))
    with pytest.raises(bundle.InputError, match="max_rank"):
        bundle.certify(graph, max_rank=11)
    with pytest.raises(bundle.InputError, match="weights"):
        bundle.certify(graph, weights="median")
    with pytest.raises(bundle.InputError, match="graph"):
        bundle.certify(3)


def test_one_edge_and_a_fixed_pose_are_certified():
    pair = ring(np.random.default_rng(0), 2, 3)
    pair = pair.replace(
        edges=pair.edges[:1],
        measurements=pair.measurements[:1],
        information=pair.information[:1],
        edge_lines=pair.edge_lines[:1],
        fixed=np.array([False, True]),
    )
    assert bundle.certify(bundle.solve(pair)).verdict == "certified"


def _random_graph(rng, dimension, *, size, isotropic=False):
    true = [random_pose(rng, dimension, size=3) for _ in range(size)]
    pairs = [(i, i + 1) for i in range(size - 1)]
    pairs += [(int(i), int(j)) for i, j in rng.integers(0, size, (size, 2)) if i != j]
    pairs = pairs or [(0, 1)]
    measured = []
    for i, j in pairs:
        (r_i, t_i), (r_j, t_j) = split(true[i]), split(true[j])
        measured.append(_moved(rng, join(r_i.T @ r_j, r_i.T @ (t_j - t_i)), 0.1))
    d = 3 if dimension == 2 else 6
    if isotropic:
        weights = [4, 4, 7] if dimension == 2 else [7, 7, 7, 4, 4, 4]
        information = np.tile(np.diag(np.array(weights, float)), (len(pairs), 1, 1))
    else:
        information = np.array([random_information(rng, d) for _ in pairs])
    return bundle.PoseGraph(
        poses=np.array(true),
        edges=np.array(pairs, np.int32),
        measurements=np.array(measured),
        information=information,
    )


def _moved(rng, pose, size):
    dimension = 2 if len(pose) == 3 else 3
    r, t = split(pose)
    by, along = split(random_pose(rng, dimension, size=size, angle=size))
    return join(r @ by, t + along)


def _shaken(graph, seed):
    rng = np.random.default_rng(seed)
    return graph.replace(poses=np.array([_moved(rng, pose, 2.0) for pose in graph.poses]))
