"""Costs of graphs beyond what a double holds: failures, however the graph is solved."""

import numpy as np
import pytest

import bundle
from tests.graphs.pose_graphs import graphs


def graph_of(function, start=(1.0,), count=1):
    graph = bundle.FactorGraph()
    for i in range(count):
        graph.add_variable(i, list(start))
        graph.add_factor(bundle.FunctionFactor([i], function))
    return graph


def huge(size):
    return lambda values: ([size * float(v) for v in values[0]], [size * np.eye(len(values[0]))])


@pytest.mark.parametrize("size", [1e155, 1e200, 1e300])
@pytest.mark.parametrize("settings", [{}, {"square_root": True}, {"linear_solver_type": "cgnr"}])
@pytest.mark.parametrize("count", [1, 3])
def test_an_infinite_cost_is_no_convergence(size, settings, count):
    result = graph_of(huge(size), count=count).solve(**settings)
    assert not result.summary.is_solution_usable
    assert result.summary.termination_type == "FAILURE"
    assert "Converged" not in result.outcome


@pytest.mark.parametrize("size", [1e100, 1e150])
def test_large_finite_costs_are_solved(size):
    result = graph_of(huge(size)).solve()
    assert result.summary.is_solution_usable
    assert abs(result.values[0][0]) < 1e-3


def test_the_sum_may_be_infinite_where_no_square_is():
    result = graph_of(huge(1e154), count=5).solve()
    assert not result.summary.is_solution_usable


@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_of_pose_graphs(backend):
    graph = graphs.loop(2)
    measurements = graph.measurements.copy()
    measurements[3, 0] = 1e160
    result = bundle.solve(graph.replace(measurements=measurements), backend=backend, init="file")
    assert not result.summary.is_solution_usable
    assert result.summary.termination_type == "FAILURE"
