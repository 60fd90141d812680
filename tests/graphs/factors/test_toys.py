"""Graphs whose solution or information is known in closed form."""

import numpy as np
import pytest

import bundle
from tests.graphs.factors import g2o

# Levenberg-Marquardt stops 1e-12 short of the optimum, where the cost does not change any more.
EXACT = {
    "function_tolerance": 0.0,
    "gradient_tolerance": 0.0,
    "parameter_tolerance": 0.0,
    "trust_region_strategy_type": "dogleg",
}


def optimum(graph):
    return np.concatenate(list(graph.solve(**EXACT).values.values()))


def line(values, edges, prior=None):
    """Scalar variables x0, x1, ... with edges (a, b, measurement, information)."""
    graph = bundle.FactorGraph()
    for i, value in enumerate(values):
        graph.add_variable(f"x{i}", [value])
    if prior is not None:
        graph.add_factor(bundle.PriorFactor("x0", *prior))
    for a, b, measurement, information in edges:
        graph.add_factor(bundle.BetweenFactor(f"x{a}", f"x{b}", [measurement], information))
    return graph


def loop():
    edges = [(0, 1, 1.0, 1.0), (1, 2, 1.0, 1.0), (2, 3, 1.0, 1.0), (3, 0, -2.8, 1.0)]
    return line([0.0, 1.0, 2.0, 3.0], edges, prior=([0.0], 1.0))


def test_the_information_of_a_loop():
    matrix, vector = loop().information()
    expected = [[3, -1, 0, -1], [-1, 2, -1, 0], [0, -1, 2, -1], [-1, 0, -1, 2]]
    np.testing.assert_allclose(matrix, expected, atol=1e-14)
    np.testing.assert_allclose(vector, [0.2, 0, 0, -0.2], atol=1e-14)
    np.testing.assert_allclose(np.linalg.solve(matrix, vector), [0, -0.05, -0.1, -0.15], atol=1e-13)


@pytest.mark.parametrize("solver", ["auto", "sparse_normal_cholesky", "dense_qr"])
def test_a_loop_spreads_its_error(solver):
    result = loop().solve(linear_solver_type=solver, **EXACT)
    assert result.summary.initial_cost == pytest.approx(0.02, abs=1e-15)
    assert result.summary.final_cost == pytest.approx(0.005, abs=1e-12)
    found = [result.values[f"x{i}"][0] for i in range(4)]
    np.testing.assert_allclose(found, [0, 0.95, 1.9, 2.85], atol=1e-12)


def test_a_weighted_cycle():
    sigmas = np.array([0.10] * 5 + [0.02])
    edges = [(i, i + 1, 1.0, 1 / 0.1**2) for i in range(5)] + [(5, 0, -5.13, 1 / 0.02**2)]
    graph = line([0.0, 1, 2, 3, 4, 5], edges, prior=([0.0], 1e4))
    found = optimum(graph)
    residuals = np.append(np.diff(found) - 1.0, found[0] - found[5] + 5.13)
    np.testing.assert_allclose(residuals, 0.13 * sigmas**2 / (sigmas**2).sum(), atol=1e-12)
    np.testing.assert_allclose(residuals[[0, 5]], [0.025794, 0.001032], atol=1e-6)


def test_chains_of_poses_have_the_counted_nonzeros():
    for poses, closures in ((3, 0), (8, 2), (50, 6)):
        graph = bundle.FactorGraph()
        for i in range(poses):
            graph.add_variable(i, [0, 0, 0, 1, i, 0, 0], "se3")
        pairs = [(i, i + 1) for i in range(poses - 1)] + [(i, i + 2) for i in range(closures)]
        for a, b in pairs:
            graph.add_factor(bundle.BetweenFactor(a, b, [0, 0, 0, 1, b - a, 0, 0], 1.0))
        graph.add_factor(bundle.PriorFactor(0, [0, 0, 0, 1, 0, 0, 0], 1.0))
        expected = 36 * (poses + 2 * (poses - 1) + 2 * closures)
        assert graph.solve().summary.num_information_nonzeros == expected


@pytest.mark.parametrize(
    ("name", "start", "best"),
    [
        ("tinyGrid3D", 286.635747107, 18.6278188671),
        ("smallGrid3D", 167788.666871, 1035.85066472),
        ("intel", 553.995795564, 45.0042330881),
    ],
)
def test_pose_graphs_reach_the_known_optimum(bundle_data, name, start, best):
    graph = g2o.read(bundle_data / "g2o" / f"{name}.g2o.bz2")
    result = graph.solve(
        function_tolerance=1e-15, gradient_tolerance=0, parameter_tolerance=0, num_threads=1
    )
    assert 2 * result.summary.initial_cost == pytest.approx(start, rel=1e-9)
    assert 2 * result.summary.final_cost == pytest.approx(best, rel=1e-9)
    moved = graph.with_values(result.values)
    assert moved.cost() == pytest.approx(result.summary.final_cost, rel=1e-12)


def given(matrix):
    """A graph of scalars with this information."""
    n = len(matrix)
    graph = bundle.FactorGraph()
    for i in range(n):
        graph.add_variable(f"x{i}", [0.0])
    for i in range(n):
        for j in range(i):
            if matrix[i][j]:
                graph.add_factor(bundle.BetweenFactor(f"x{j}", f"x{i}", [0.0], -matrix[i][j]))
    for i, rest in enumerate(np.sum(matrix, axis=1)):
        if rest:
            graph.add_factor(bundle.PriorFactor(f"x{i}", [0.0], rest))
    return graph


@pytest.mark.parametrize(
    ("matrix", "dropped", "expected"),
    [
        ([[2, -1, 0], [-1, 2, -1], [0, -1, 1]], 1, [[1.5, -0.5], [-0.5, 0.5]]),
        ([[5, -4, 0], [-4, 8, -4], [0, -4, 4]], 0, [[4.8, -4], [-4, 4]]),
        ([[5, -4, 0], [-4, 8, -4], [0, -4, 4]], 1, [[3, -2], [-2, 2]]),
    ],
)
def test_eliminations_by_hand(matrix, dropped, expected):
    graph = given(matrix)
    np.testing.assert_allclose(graph.information()[0], matrix, atol=1e-13)
    kept = [f"x{i}" for i in range(3) if i != dropped]
    found, _ = graph.information(kept)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_array_equal(found, found.T)
    turned, _ = graph.information(kept[::-1])
    np.testing.assert_allclose(turned, np.array(expected)[::-1, ::-1], atol=1e-12)


def test_an_elimination_with_its_vector():
    matrix = [[5, -4, 0], [-4, 8, -4], [0, -4, 4]]
    # x = (0.1, 1.1, 2.1): a prior of 0.1 and steps of 1.
    graph = line([0.0] * 3, [(0, 1, 1.0, 4.0), (1, 2, 1.0, 4.0)], prior=([0.1], 1.0))
    whole, eta = graph.information()
    np.testing.assert_allclose(whole, matrix, atol=1e-13)
    np.testing.assert_allclose(eta, [-3.9, 0, 4], atol=1e-13)
    kept, rest = graph.information(["x1", "x2"])
    np.testing.assert_allclose(rest, [-3.12, 4], atol=1e-12)
    np.testing.assert_allclose(np.linalg.solve(kept, rest), [1.1, 2.1], atol=1e-12)


@pytest.mark.parametrize("degree", [2, 3, 10])
def test_a_star_leaves_a_clique_that_still_knows_no_place(degree):
    graph = bundle.FactorGraph()
    graph.add_variable("hub", [0.0])
    for i in range(degree):
        graph.add_variable(i, [float(i)])
        graph.add_factor(bundle.BetweenFactor("hub", i, [float(i)], 1.0))
    prior = graph.marginalize(["hub"])
    assert prior.keys == tuple(range(degree))
    np.testing.assert_allclose(prior.Lambda, np.eye(degree) - np.full((degree,) * 2, 1 / degree),
                               atol=1e-14)  # fmt: skip
    assert np.abs(prior.Lambda @ np.ones(degree)).max() < 1e-14


def poses(seed=3, count=6, manifold="se3"):
    """A loop of poses with noisy edges and a prior, and the values of its optimum."""
    rng = np.random.default_rng(seed)
    size = {"se2": 3, "se3": 7}[manifold]
    graph = bundle.FactorGraph()
    for i in range(count):
        graph.add_variable(i, rng.standard_normal(size), manifold)
    for i in range(count):
        graph.add_factor(
            bundle.BetweenFactor(i, (i + 1) % count, rng.standard_normal(size), 1.0 + i)
        )
    graph.add_factor(bundle.PriorFactor(0, rng.standard_normal(size), 2.0))
    return graph


@pytest.mark.parametrize("manifold", ["se2", "se3"])
def test_a_prior_and_the_rest_have_the_information_of_the_whole(manifold):
    graph = poses(manifold=manifold)
    rest = graph.without([1, 2])
    assert rest.keys == (0, 3, 4, 5) and len(rest.factors) == 4
    prior = graph.marginalize([1, 2])
    assert set(prior.keys) == {0, 3}
    rest.add_factor(prior)
    for kept in ([0, 3, 4, 5], [4], [5, 0]):
        matrix, vector = graph.information(kept)
        found, found_vector = rest.information(kept)
        np.testing.assert_allclose(found, matrix, atol=1e-12 * np.abs(matrix).max())
        np.testing.assert_allclose(found_vector, vector, atol=1e-11 * np.abs(vector).max())
    assert len(graph.keys) == 6 and len(graph.factors) == 7


def test_information_is_the_schur_complement_of_dense_algebra():
    graph = poses(seed=5)
    whole, eta = graph.information()
    b, a = np.arange(12, 24), np.r_[0:12, 24:36]
    solved = np.linalg.solve(whole[np.ix_(a, a)], np.c_[whole[np.ix_(a, b)], eta[a]])
    matrix, vector = graph.information([2, 3])
    expected = whole[np.ix_(b, b)] - whole[np.ix_(b, a)] @ solved[:, :-1]
    np.testing.assert_allclose(matrix, expected, atol=1e-12 * np.abs(whole).max())
    expected = eta[b] - whole[np.ix_(b, a)] @ solved[:, -1]
    np.testing.assert_allclose(vector, expected, atol=1e-12 * np.abs(eta).max())


def test_fixed_coordinates_of_what_is_eliminated_stay():
    graph = line([0.0, 1.0, 2.5], [(0, 1, 1.0, 4.0), (1, 2, 1.0, 4.0)])
    matrix, vector = graph.information(["x1", "x2"])
    np.testing.assert_allclose(matrix, [[4, -4], [-4, 4]], atol=1e-14)  # x0 may follow
    held = bundle.FactorGraph()
    for key in graph.keys:
        held.add_variable(key, graph.values[key], fixed=key == "x0")
    for factor in graph.factors:
        held.add_factor(factor)
    matrix, vector = held.information(["x1", "x2"])
    np.testing.assert_allclose(matrix, [[8, -4], [-4, 4]], atol=1e-14)
    np.testing.assert_allclose(vector, [2, -2], atol=1e-14)


def test_re_anchoring_keeps_the_minimiser():
    graph = line([0.3, -1.0, 2.0], [(0, 1, 1.0, 4.0), (1, 2, 1.0, 4.0)], prior=([0.1], 1.0))
    prior = graph.marginalize(["x0"])
    moved = prior.reanchor({"x1": [0.7]})
    step = moved.linearization_point["x1"] - prior.linearization_point["x1"]
    np.testing.assert_array_equal(moved.Lambda, prior.Lambda)
    np.testing.assert_allclose(moved.eta, prior.eta - prior.Lambda @ step, rtol=1e-15)
    optima = []
    for factor in (prior, moved):
        rest = graph.without(["x0"])
        rest.add_factor(factor)
        optima.append(optimum(rest))
    np.testing.assert_allclose(optima[0], optima[1], atol=1e-12)
    np.testing.assert_allclose(optima[0], [1.1, 2.1], atol=1e-12)


@pytest.mark.parametrize("num_free", [0, 1, 3])
def test_constant_variables_with_factors_have_a_cost(num_free):
    graph = bundle.FactorGraph()
    graph.add_variable("held", [0.0, 0.0, 0.0], "euclidean", fixed=True)
    graph.add_factor(bundle.PriorFactor("held", [1.0, 2.0, 3.0], 1.0))
    for k in range(num_free):
        graph.add_variable(k, [5.0, 0.0, 0.0], "euclidean")
        graph.add_factor(bundle.PriorFactor(k, [1.0, 2.0, 3.0], 1.0))
    result = graph.solve()
    assert result.summary.final_cost == pytest.approx(7.0)
    np.testing.assert_array_equal(result.values["held"], [0, 0, 0])
