"""Graphs whose factors are linear end at the minimum, to rounding, whatever was asked for."""

import numpy as np
import pytest

import bundle

WAYS = {
    "default": {},
    "gauss_newton": {"trust_region_strategy_type": "gauss_newton"},
    "dogleg": {"trust_region_strategy_type": "dogleg"},
    "subspace": {"trust_region_strategy_type": "subspace_dogleg"},
    "square_root": {"square_root": True},
    "dense": {"linear_solver_type": "dense_normal_cholesky"},
    "sparse": {"linear_solver_type": "sparse_normal_cholesky", "square_root": False},
    "qr": {"linear_solver_type": "dense_qr"},
    "ceres": {"backend": "ceres", "num_threads": 2},
    "rough": {"function_tolerance": 1e-2},
    "exact": {"function_tolerance": 0.0, "gradient_tolerance": 0.0, "parameter_tolerance": 1e-16},
}


def random_graph(seed, *, num=12, size=2, functions=False, decades=0.0, far=1.0):
    """Variables of numbers with priors and differences, and the rows of all of them."""
    rng = np.random.default_rng(seed)
    graph, rows, right = bundle.FactorGraph(), [], []
    for i in range(num):
        graph.add_variable(i, far * rng.normal(size=size))

    def add(first, second, value, weight):
        information = weight**2 * np.eye(size)
        row = np.zeros((size, num * size))
        row[:, second * size : (second + 1) * size] = weight * np.eye(size)
        if first is None:
            graph.add_factor(bundle.PriorFactor(second, value, information))
        else:
            row[:, first * size : (first + 1) * size] = -weight * np.eye(size)
            graph.add_factor(bundle.BetweenFactor(first, second, value, information))
        rows.append(row)
        right.append(weight * value)

    add(None, 0, rng.normal(size=size), 1.0)
    for i in range(1, num):
        add(i - 1, i, rng.normal(size=size), 10 ** rng.uniform(-decades, decades))
    for _ in range(num // 2):
        i, j = rng.choice(num, 2, replace=False).tolist()
        add(i, j, rng.normal(size=size), 10 ** rng.uniform(-decades, decades))
    if functions:
        a, b, c = rng.normal(size=(3, size)), rng.normal(size=(3, size)), rng.normal(size=3)
        graph.add_factor(bundle.FunctionFactor([2, 5], lambda v: (a @ v[0] + b @ v[1] - c, [a, b])))
        row = np.zeros((3, num * size))
        row[:, 2 * size : 3 * size], row[:, 5 * size : 6 * size] = a, b
        rows.append(row)
        right.append(c)
    return graph, np.concatenate(rows), np.concatenate(right)


def solution(graph, result):
    return np.concatenate([result.values[key] for key in graph.keys])


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("functions", [False, True])
def test_the_end_is_that_of_least_squares(way, functions):
    for seed, decades, far in ((0, 0.0, 1.0), (1, 1.5, 1.0), (2, 0.0, 1e6), (3, 1.0, 0.0)):
        graph, rows, right = random_graph(seed, functions=functions, decades=decades, far=far)
        expected = np.linalg.lstsq(rows, right, rcond=None)[0]
        result = graph.solve(**WAYS[way])
        assert result.summary.termination_type == "CONVERGENCE"
        bound = 1e-14 * np.linalg.cond(rows) * max(1, np.abs(expected).max())
        np.testing.assert_allclose(solution(graph, result), expected, atol=bound)
        cost = 0.5 * ((rows @ expected - right) ** 2).sum()
        assert result.summary.final_cost == pytest.approx(cost, rel=1e-12)
        assert result.iterations["cost"][-1] == pytest.approx(result.summary.final_cost, rel=1e-14)
        steps = np.asarray(result.iterations["step_is_successful"])
        assert result.summary.num_successful_steps == steps.sum()
        again = graph.with_values(result.values).solve(**WAYS[way])
        np.testing.assert_allclose(solution(graph, again), expected, atol=bound)


def test_a_loop_of_numbers_gives_each_edge_a_quarter():
    graph = bundle.FactorGraph()
    for i in range(4):
        graph.add_variable(i, [float(i)])
    graph.add_factor(bundle.PriorFactor(0, [0.0], 1))
    for i, j, z in ((0, 1, 1.0), (1, 2, 1.0), (2, 3, 1.0), (3, 0, -2.8)):
        graph.add_factor(bundle.BetweenFactor(i, j, [z], 1))
    found = solution(graph, graph.solve())
    np.testing.assert_allclose(found, [0, 0.95, 1.9, 2.85], rtol=0, atol=2e-15)


@pytest.mark.parametrize("way", ["default", "gauss_newton", "square_root", "sparse"])
def test_held_coordinates_stay_and_directions_without_a_factor_hardly_move(way):
    graph, rows, right = random_graph(5)
    graph.add_variable("held", [3.0, 4.0], fixed=[1])
    graph.add_factor(bundle.BetweenFactor(0, "held", [1.0, 1.0], 4 * np.eye(2)))
    graph.add_variable("half", [7.0, 8.0])
    graph.add_factor(
        bundle.LinearPrior(np.diag([2.0, 0.0]), [1.0, 0.0], {"half": [7.0, 8.0]}, ["half"])
    )
    result = graph.solve(**WAYS[way])
    row = np.zeros((2, 25))
    row[:, :2], row[0, 24] = -2 * np.eye(2), 2
    rows = np.concatenate([np.pad(rows, ((0, 0), (0, 1))), row])
    right = np.concatenate([right, [2.0, 2 * (1 - 4.0)]])
    expected = np.linalg.lstsq(rows, right, rcond=None)[0]
    found = solution(graph, result)
    np.testing.assert_allclose(np.delete(found, [25, 26, 27]), expected, atol=1e-13)
    assert result.values["held"][1] == 4.0
    np.testing.assert_allclose(result.values["half"], [7.5, 8.0], atol=1e-9)


def test_bounds_that_hold_stay_on_their_bound():
    graph = bundle.FactorGraph()
    graph.add_variable("a", [0.5, 0.5], lower=0.0, upper=1.0)
    graph.add_variable("b", [0.0, 0.0])
    graph.add_factor(bundle.PriorFactor("a", [3.0, 0.3], np.array([[2.0, 1], [1, 2]])))
    graph.add_factor(bundle.BetweenFactor("a", "b", [1.0, 1.0], 1.0))
    result = graph.solve()
    # With a[0] = 1: minimise (x - .3)^2 + (1 - 3) (x - .3) over x = a[1], b follows.
    np.testing.assert_allclose(result.values["a"], [1.0, 1.0], atol=1e-15)
    graph.add_factor(bundle.PriorFactor("a", [1.0, -0.6], 100.0))
    free = 0.01 * (2 * 0.3 + 2 - 60) / (0.01 * 102)
    result = graph.solve()
    expected = max(free, 0.0)
    np.testing.assert_allclose(result.values["a"], [1.0, expected], atol=1e-14)
    np.testing.assert_allclose(result.values["b"], result.values["a"] + 1, atol=1e-14)


def test_curved_graphs_and_stopped_ones_are_left_as_they_are():
    curved = bundle.FactorGraph()
    curved.add_variable("x", [0.5])
    curved.add_factor(bundle.FunctionFactor(["x"], lambda v: (v[0] ** 2 - 3, [2 * v[0][:, None]])))
    curved.add_factor(bundle.PriorFactor("x", [1.0], 1.0))
    result = curved.solve(function_tolerance=1e-3)
    assert 1.0 not in list(result.iterations["relative_decrease"])
    graph, _, _ = random_graph(7)
    stopped = graph.solve(max_num_iterations=1)
    assert stopped.summary.termination_type == "NO_CONVERGENCE"
    assert len(stopped.iterations["cost"]) == 2
    robust = random_graph(7)[0]
    robust.add_factor(bundle.PriorFactor(3, [50.0, 50.0], 1.0, loss="cauchy"))
    count = len(robust.solve().iterations["cost"])
    assert robust.solve().iterations["relative_decrease"][-1] != 1.0 and count > 2


def test_gauss_newton_takes_an_undamped_step_on_graphs_alone():
    graph, rows, right = random_graph(3)
    one = graph.solve(trust_region_strategy_type="gauss_newton", max_num_iterations=1)
    expected = np.linalg.lstsq(rows, right, rcond=None)[0]
    np.testing.assert_allclose(solution(graph, one), expected, atol=1e-12)
    damped = graph.solve(max_num_iterations=1)
    assert np.abs(solution(graph, damped) - expected).max() > 1e-6
    assert one.options.trust_region_strategy_type == "gauss_newton"
    options = bundle.SolveOptions(function_tolerance=1e-3)
    assert graph.solve(options).options.function_tolerance == 1e-3
    with pytest.raises(bundle.InputError, match="trust_region_strategy_type: expected one of"):
        bundle.SolveOptions(trust_region_strategy_type="gauss_newton")
