"""Bounds: against bounded least squares of SciPy, and the conditions of an optimum."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

import bundle

TIGHT = {
    "function_tolerance": 0.0,
    "parameter_tolerance": 0.0,
    "gradient_tolerance": 1e-11,
    "max_num_iterations": 300,
}


def linear_graph(a, b, start, lower, upper):
    """1/2 ||A x - b||^2, x in two variables, one row a factor."""
    graph = bundle.FactorGraph()
    cut = len(start) // 2
    for key, part in (("x", slice(None, cut)), ("y", slice(cut, None))):
        graph.add_variable(key, start[part], lower=lower[part], upper=upper[part])
    for row, target in zip(a, b, strict=True):

        def function(values, row=row, target=target):
            return [row @ np.concatenate(values) - target], [[row[:cut]], [row[cut:]]]

        graph.add_factor(bundle.FunctionFactor(["x", "y"], function))
    return graph


@pytest.mark.parametrize("seed", range(8))
def test_linear_problems_end_where_those_of_scipy_do(seed):
    rng = np.random.default_rng(seed)
    size = 7
    a, b = rng.standard_normal((12, size)), 5 * rng.standard_normal(12)
    lower = np.where(rng.random(size) < 0.7, -0.4 * rng.random(size), -np.inf)
    upper = np.where(rng.random(size) < 0.7, 0.4 * rng.random(size), np.inf)
    best = lsq_linear(a, b, (lower, upper), method="bvls", tol=1e-15)
    assert 1 <= np.count_nonzero(best.active_mask) < size
    start = np.clip(rng.choice([-1.0, 0.0, 1.0], size), lower, upper)  # many on a bound
    result = linear_graph(a, b, start, lower, upper).solve(**TIGHT)
    found = np.concatenate([result.values["x"], result.values["y"]])
    assert (found >= lower).all() and (found <= upper).all()
    np.testing.assert_allclose(found, best.x, atol=1e-8)
    np.testing.assert_array_equal(found[best.active_mask < 0], lower[best.active_mask < 0])
    np.testing.assert_array_equal(found[best.active_mask > 0], upper[best.active_mask > 0])
    assert result.summary.termination_type == "CONVERGENCE"


def valley(values):
    x, y = values[0]
    return [10 * (y - x * x), 1 - x], [[[-20 * x, 10], [-1, 0]]]


@pytest.mark.parametrize("push", [0, 1, 100, 1e6])
@pytest.mark.parametrize("loss", ["trivial", "huber"])
def test_a_variable_that_pushes_against_its_bound_does_not_stop_the_others(push, loss):
    """Ceres compares the cost with a model in which the bound gives way, and would end here."""
    graph = bundle.FactorGraph()
    graph.add_variable("a", [-1.2, 1.0])
    graph.add_factor(bundle.FunctionFactor(["a"], valley))
    graph.add_variable("b", [1.0], lower=0)
    graph.add_factor(bundle.PriorFactor("b", [-push], 1.0, loss=loss, loss_scale=2.0))
    result = graph.solve(**TIGHT)
    assert result.values["b"] == (0 if push else pytest.approx(0, abs=1e-9))
    # The cost of both has only so many digits.
    residual, _ = valley([result.values["a"]])
    assert np.square(residual).sum() <= 1e-20 + 1e-15 * result.summary.final_cost


@pytest.mark.parametrize(("upper", "expected"), [(0.5, [0.5, 0.25]), (2.0, [1.0, 1.0])])
def test_a_bound_within_the_valley(upper, expected):
    graph = bundle.FactorGraph()
    graph.add_variable("a", [-1.2, 1.0], upper=[upper, np.inf])
    graph.add_factor(bundle.FunctionFactor(["a"], valley))
    np.testing.assert_allclose(graph.solve(**TIGHT).values["a"], expected, atol=1e-9)


def test_a_start_on_a_bound_leaves_it_when_the_cost_falls_inside():
    graph = bundle.FactorGraph()
    graph.add_variable("x", [1.0, -1.0, 1.0], lower=-1, upper=1)
    graph.add_factor(bundle.PriorFactor("x", [0.25, -0.5, 8.0], np.diag([1.0, 1e4, 1e-4])))
    np.testing.assert_allclose(graph.solve(**TIGHT).values["x"], [0.25, -0.5, 1], atol=1e-9)


def test_factors_pull_at_a_bound_with_their_robust_weights():
    """Outwards 100 with the weight 2 / 100, inwards 3: it is not active, and 2 + x - 3 = 0."""
    graph = bundle.FactorGraph()
    graph.add_variable("x", [0.0], lower=0)
    graph.add_factor(bundle.PriorFactor("x", [-100.0], 1.0, loss="huber", loss_scale=2.0))
    graph.add_factor(bundle.PriorFactor("x", [3.0], 1.0))
    np.testing.assert_allclose(graph.solve(**TIGHT).values["x"], 1, atol=1e-9)


def test_held_coordinates_stay_beside_bounds():
    graph = bundle.FactorGraph()
    graph.add_variable("x", [0.5, 0.5, 0.5], lower=0, upper=[1, 1, np.inf], fixed=[1])
    graph.add_factor(bundle.PriorFactor("x", [-3.0, 7.0, 9.0], 1.0))
    np.testing.assert_allclose(graph.solve(**TIGHT).values["x"], [0, 0.5, 9], atol=1e-12)


def test_bounds_that_are_one_number_hold_the_variable():
    graph = bundle.FactorGraph()
    graph.add_variable("x", [2.0, 1.0], lower=[2, -np.inf], upper=[2, np.inf])
    graph.add_factor(bundle.PriorFactor("x", [5.0, 4.0], [[2.0, 1.0], [1.0, 2.0]]))
    # Of 1/2 r^T Omega r with r = (-3, y - 4): y - 4 = 3 / 2.
    result = graph.solve(**TIGHT, trust_region_strategy_type="levenberg_marquardt")
    np.testing.assert_allclose(result.values["x"], [2, 5.5], atol=1e-9)
    again = graph.with_values(result.values)
    assert again.solve(**TIGHT).values["x"][0] == 2
    with pytest.raises(bundle.InputError, match="variable 'x'"):
        graph.with_values({"x": [2.5, 1]})


def test_the_tolerance_of_the_cost_bounds_the_error():
    """A step whose cost changes by less than the tolerance ends the solve and is not taken."""
    graph = bundle.FactorGraph()
    graph.add_variable("x", [0.5, 0.5], lower=0, upper=[1, np.inf])
    graph.add_factor(bundle.PriorFactor("x", [-3.0, 9.0], 1.0))
    result = graph.solve(function_tolerance=1e-6)
    error = result.values["x"] - [0, 9]
    assert 0.5 * error @ error <= 1e-6 * result.summary.final_cost


def test_ctrl_c_and_exceptions_while_active_bounds_are_looked_for():
    def fail(values):
        if values[0][0] == 0:
            raise ZeroDivisionError("at the bound")
        return values[0] + 3, [[[1.0]]]

    graph = bundle.FactorGraph()
    graph.add_variable("x", [1.0], lower=0)
    graph.add_factor(bundle.FunctionFactor(["x"], fail))
    with pytest.raises(ZeroDivisionError, match="at the bound"):
        graph.solve()
