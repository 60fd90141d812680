"""Nullities, fill, robust curvature, windows: facts about graphs that hold whatever the numbers."""

import numpy as np
import pytest

import bundle
from bundle import _core

EXACT = {
    "function_tolerance": 0.0,
    "gradient_tolerance": 0.0,
    "parameter_tolerance": 0.0,
    "trust_region_strategy_type": "dogleg",
}
SIZES = {"euclidean": 2, "so2": 1, "so3": 4, "se2": 3, "se3": 7}


def random_value(rng, manifold):
    value = rng.standard_normal(SIZES[manifold])
    if manifold in ("so3", "se3"):
        value[:4] /= np.linalg.norm(value[:4])
    return value


def components(rng, manifold, count):
    """Loops of four with edges that contradict each other, nothing between them."""
    graph = bundle.FactorGraph()
    for c in range(count):
        for i in range(4):
            graph.add_variable((c, i), random_value(rng, manifold), manifold)
        for i in range(4):
            edge = random_value(rng, manifold)
            graph.add_factor(bundle.BetweenFactor((c, i), (c, (i + 1) % 4), edge, 1.0 + i))
    return graph


def nullity(matrix):
    singular = np.linalg.svd(matrix, compute_uv=False)
    return int((singular < singular[0] * len(matrix) * np.finfo(float).eps).sum())


@pytest.mark.parametrize(
    ("manifold", "gauge"), [("euclidean", 2), ("so2", 1), ("so3", 3), ("se2", 3), ("se3", 6)]
)
@pytest.mark.parametrize("count", [1, 3])
def test_each_component_has_the_gauge_of_its_manifold(manifold, gauge, count):
    """Moving the world changes no edge, at the optimum or not."""
    graph = components(np.random.default_rng(7), manifold, count)
    matrix, _ = graph.information()
    assert nullity(matrix) == gauge * count
    graph.add_factor(bundle.PriorFactor((0, 2), graph.values[0, 2], 1.0))
    assert nullity(graph.information()[0]) == gauge * (count - 1)


def bundle_adjustment():
    rng = np.random.default_rng(1)
    graph = bundle.FactorGraph()
    graph.add_variable("camera", [500.0, 320, 240], fixed=True)
    for i in range(3):
        pose = np.array([0, 0, 0, 1.0, -i, i * i, 6])
        pose = _core.retract("se3", pose, 0.1 * rng.standard_normal(6))
        graph.add_variable(("pose", i), pose, "se3")
    for j in range(8):
        graph.add_variable(("point", j), rng.uniform(-1, 1, 3))
        for i in range(3):
            seen = 300 + 50 * rng.standard_normal(2)
            keys = ("pose", i), "camera", ("point", j)
            graph.add_factor(bundle.ReprojectionFactor(*keys, seen, "SIMPLE_PINHOLE"))
    return graph


@pytest.mark.parametrize(("num_positions", "expected"), [(0, 7), (1, 4), (2, 1), (3, 0)])
def test_positions_take_the_gauge_of_bundle_adjustment_away(num_positions, expected):
    """One position leaves rotation and scale of seven degrees, two a rotation about their line."""
    graph = bundle_adjustment()
    free = [key for key in graph.keys if key != "camera"]
    for i in range(num_positions):
        pose = graph.values["pose", i]
        center = -rotation(pose).T @ pose[4:]
        graph.add_factor(bundle.PositionFactor(("pose", i), center, 1e3))  # met exactly
    matrix, _ = graph.information(free)
    scale = np.sqrt(np.diag(matrix))
    eigenvalues = np.linalg.eigvalsh(matrix / np.outer(scale, scale))
    assert (eigenvalues < 1e-12).sum() == (eigenvalues < 1e-8).sum() == expected


def rotation(pose):
    x, y, z, w = pose[:4]
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * hat + 2 * hat @ hat


@pytest.mark.parametrize("degree", [2, 3, 4, 10, 50, 200])
def test_eliminating_a_hub_fills_what_it_joined(degree):
    graph = bundle.FactorGraph()
    graph.add_variable("hub", [0.0])
    for i in range(degree):
        graph.add_variable(i, [0.0])
        graph.add_factor(bundle.BetweenFactor("hub", i, [0.0], 1.0))
    before, _ = graph.information()
    prior = graph.marginalize(["hub"])
    after = np.asarray(prior.Lambda)
    assert np.count_nonzero(before) == 3 * degree + 1
    assert np.count_nonzero(after) == degree**2
    joined_before = np.count_nonzero(np.triu(before[1:, 1:], 1))
    assert np.count_nonzero(np.triu(after, 1)) - joined_before == degree * (degree - 1) // 2
    rest = graph.without(["hub"])
    rest.add_factor(prior)
    assert rest.solve().summary.num_information_nonzeros == degree**2


@pytest.mark.parametrize(
    ("residual", "curvature"), [(0.5, 3.2), (1, 2.0), (2, 0.8), (3, 0.4), (10, 4 / 101)]
)
def test_a_robust_factor_has_the_information_of_its_weight(residual, curvature):
    """Cauchy of scale 1, J = 2: rho' J^2. The full second derivative is negative from r = 1 on."""
    graph = bundle.FactorGraph()
    graph.add_variable("x", [residual / 2])
    graph.add_factor(
        bundle.FunctionFactor(["x"], lambda v: (2 * v[0], [[[2.0]]]), loss="cauchy", loss_scale=1.0)
    )
    matrix, vector = graph.information()
    np.testing.assert_allclose(matrix, curvature, rtol=1e-12)
    np.testing.assert_allclose(vector, -curvature / 2 * residual, rtol=1e-12)
    full = curvature - 8 * residual**2 / (1 + residual**2) ** 2
    expected = {0.5: 1.920, 1: 0, 2: -0.480, 3: -0.320, 10: -0.038}[residual]
    assert full == pytest.approx(expected, abs=1e-3)


def quadratic(prior, x):
    """1/2 d^T Lambda d - eta^T d of a Euclidean prior."""
    d = np.concatenate([x[key] - prior.linearization_point[key] for key in prior.keys])
    return 0.5 * d @ prior.Lambda @ d - prior.eta @ d


def test_re_anchoring_moves_the_cost_by_the_quadratic_of_the_step_and_not_the_factor():
    rng = np.random.default_rng(4)
    half = rng.standard_normal((5, 5))
    points = {"a": rng.standard_normal(2), "b": rng.standard_normal(3)}
    prior = bundle.LinearPrior(half @ half.T, rng.standard_normal(5), points, ["a", "b"])
    there = {key: value + rng.standard_normal(len(value)) for key, value in points.items()}
    moved = prior.reanchor({**there, "of another factor": [1.0]})
    dx = np.concatenate([there[key] - points[key] for key in prior.keys])
    jump = 0.5 * dx @ prior.Lambda @ dx - prior.eta @ dx
    for _ in range(3):
        x = {key: rng.standard_normal(len(value)) for key, value in points.items()}
        assert quadratic(prior, x) - quadratic(moved, x) == pytest.approx(jump, rel=1e-12)
        costs = []
        for factor in (prior, moved):
            graph = bundle.FactorGraph()
            for key, value in x.items():
                graph.add_variable(key, value)
            graph.add_factor(factor)
            costs.append(graph.cost())
        assert costs[1] == pytest.approx(costs[0], rel=1e-11)
    back = moved.reanchor(points)
    np.testing.assert_allclose(back.eta, prior.eta, rtol=1e-12, atol=1e-12)
    with pytest.raises(bundle.InputError, match="variable 'b'"):
        prior.reanchor({"a": [0, 0]})


@pytest.mark.parametrize("manifold", ["se2", "se3"])
def test_re_anchoring_on_a_curved_manifold_has_the_gradient_of_the_old_prior_there(manifold):
    """To first order in the step: d becomes d - step."""
    rng = np.random.default_rng(2)
    value = random_value(rng, manifold)
    size = len(_core.local_coordinates(manifold, value, value))
    half = rng.standard_normal((size, size))
    eta = rng.standard_normal(size)
    prior = bundle.LinearPrior(half @ half.T, eta, {"x": value}, ["x"], manifolds={"x": manifold})
    moved = prior.reanchor({"x": _core.retract(manifold, value, np.full(size, 1e-7))})
    vectors = []
    for factor in (prior, moved):
        graph = bundle.FactorGraph()
        graph.add_variable("x", moved.linearization_point["x"], manifold)
        graph.add_factor(factor)
        vectors.append(graph.information()[1])
    np.testing.assert_allclose(vectors[0], vectors[1], atol=1e-5)
    np.testing.assert_allclose(vectors[1], moved.eta, atol=1e-10)


def chain_edges(rng, steps):
    """Steps k, k + 1 (w = 4) and skips k, k + 2 (w = 9), measured with noise."""
    edges = []
    for k in range(steps):
        if k >= 1:
            edges.append((k - 1, k, 1 + 0.5 * rng.standard_normal(), 4.0))
        if k >= 2:
            edges.append((k - 2, k, 2 + 0.33 * rng.standard_normal(), 9.0))
    return edges


def window_of(steps, size, *, marginalize):
    """Estimates of the last frames by a window that slides over a chain, and by everything."""
    edges = chain_edges(np.random.default_rng(11), steps)
    everything, window = bundle.FactorGraph(), bundle.FactorGraph()
    for k in range(steps):
        for graph in (everything, window):
            graph.add_variable(k, [float(k)])
            if k == 0:
                graph.add_factor(bundle.PriorFactor(0, [0.0], 1.0))
            for a, b, measured, weight in edges:
                if b == k:
                    graph.add_factor(bundle.BetweenFactor(a, b, [measured], weight))
        if len(window.keys) > size:
            window = window.with_values(window.solve(**EXACT).values)
            oldest = window.keys[0]
            prior = window.marginalize([oldest])
            window = window.without([oldest])
            if marginalize:
                window.add_factor(prior)
            elif not any(isinstance(f, bundle.PriorFactor) for f in window.factors):
                window.add_factor(
                    bundle.PriorFactor(window.keys[0], window.values[oldest + 1], 1.0)
                )
    found = window.solve(**EXACT).values
    best = everything.solve(**EXACT).values
    return max(abs(found[key][0] - best[key][0]) for key in found)


def test_a_window_that_marginalises_knows_what_everything_knows():
    assert window_of(60, 6, marginalize=True) < 1e-11
    assert window_of(60, 6, marginalize=False) > 0.01


def test_information_that_no_memory_holds_is_refused():
    graph = bundle.FactorGraph()
    size = 400_000  # 3 x 1.28 TB
    graph.add_variable("x", np.zeros(size))
    graph.add_factor(
        bundle.FunctionFactor(["x"], lambda values: ([values[0][0]], [np.eye(1, size)]))
    )
    with pytest.raises(bundle.InputError, match=r"^keys: .* 400000 coordinates"):
        graph.information()
