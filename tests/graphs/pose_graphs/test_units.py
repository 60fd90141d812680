"""Solves do not depend on the units of information and of length."""

import numpy as np
import pytest

import bundle
from tests.graphs.pose_graphs import graphs

SCALES = (1e-200, 1e-100, 1e-20, 1e-14, 1e-9, 1e9, 1e100, 1e200)


def in_length(graph, unit):
    """Return the graph with all lengths multiplied by a unit, and the information to match."""
    lengths = slice(0, 2) if graph.dimension == 2 else slice(4, 7)
    factors = np.full(graph.tangent_size, 1.0)
    factors[slice(0, 2) if graph.dimension == 2 else slice(3, 6)] = 1 / unit
    poses, measurements = graph.poses.copy(), graph.measurements.copy()
    poses[:, lengths] *= unit
    measurements[:, lengths] *= unit
    information = graph.information * factors[:, None] * factors
    return graph.replace(poses=poses, measurements=measurements, information=information)


@pytest.mark.parametrize("init", ["file", "lower", "auto"])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_the_scale_of_the_information_changes_nothing(backend, dimension, init):
    graph = graphs.loop(dimension, seed=2, noise=0.1, start_noise=0.3)
    options = {"backend": backend, "init": init}
    one = bundle.solve(graph, **options)
    for scale in SCALES:
        found = bundle.solve(graph.replace(information=graph.information * scale), **options)
        assert found.summary.termination_type == "CONVERGENCE", scale
        assert found.summary.num_successful_steps == one.summary.num_successful_steps, scale
        np.testing.assert_allclose(found.problem.poses, one.problem.poses, atol=1e-9)
        for name in ("chi2_initial", "chi2_start", "chi2_final", "initial_cost", "final_cost"):
            value, expected = getattr(found.summary, name), getattr(one.summary, name)
            assert value / scale == pytest.approx(expected, rel=1e-9), (scale, name)
        names = ["cost", "cost_change", "gradient_max_norm"]
        if backend == "ceres" and dimension == 3:
            names.pop()  # that of Ceres is the length of a step along the gradient: not linear
        for name in names:
            rows = slice(0, -1) if name != "cost" else slice(None)  # the last one is rounding
            given = found.iterations[name][rows] / scale
            expected = one.iterations[name][rows]
            np.testing.assert_allclose(given, expected, rtol=1e-3, atol=1e-9 * expected.max())
        for name in ("chi2_before", "chi2_after"):
            given, expected = getattr(found, name) / scale, getattr(one, name)
            np.testing.assert_allclose(given, expected, rtol=1e-6, atol=1e-20)


@pytest.mark.parametrize("loss", ["huber", "cauchy", "arctan", "tukey", "dcs", "geman_mcclure"])
def test_scales_of_losses_follow_the_information(loss):
    graph = graphs.loop(2, seed=4, noise=0.1, start_noise=0.2)
    one = bundle.solve(graph, loss=loss, loss_scale=0.3)
    assert (one.weights < 0.999).any()
    for scale in (1e-14, 1e14):
        found = bundle.solve(
            graph.replace(information=graph.information * scale),
            loss=loss,
            loss_scale=0.3 * np.sqrt(scale),
        )
        np.testing.assert_allclose(found.problem.poses, one.problem.poses, atol=1e-8)
        np.testing.assert_allclose(found.weights, one.weights, rtol=1e-6)
        assert found.summary.final_cost / scale == pytest.approx(one.summary.final_cost, rel=1e-9)
        costs = found.iterations["cost"] / scale
        np.testing.assert_allclose(costs, one.iterations["cost"], rtol=1e-6)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_unit_of_length_changes_nothing(dimension):
    graph = graphs.loop(dimension, seed=2, noise=0.1, start_noise=0.3)
    one = bundle.solve(graph)
    for unit in (1e-6, 1e-3, 1e3, 1e6):
        found = bundle.solve(in_length(graph, unit))
        there = in_length(one.problem, unit)
        assert found.summary.chi2_final == pytest.approx(one.summary.chi2_final, rel=1e-9)
        scale = np.abs(there.poses).max(axis=0)
        np.testing.assert_allclose(found.problem.poses / scale, there.poses / scale, atol=1e-7)


def test_the_gradient_tolerance_holds_in_both_units():
    """A gradient that is small in one unit of length does not end a solve in the other."""
    graph = in_length(graphs.loop(2, seed=2, noise=0.1, start_noise=0.3), 1e6)
    options = {"function_tolerance": 0.0, "parameter_tolerance": 0.0, "init": "file"}
    found = bundle.solve(graph, gradient_tolerance=1e-2, **options)
    assert "Gradient tolerance" in found.summary.message
    exact = bundle.solve(graph, init="file").problem.poses
    np.testing.assert_allclose(found.problem.poses[:, :2], exact[:, :2], atol=1e6 * 1e-5)
    assert bundle.solve(graph, gradient_tolerance=1e20, **options).summary.num_linear_solves == 0


def test_the_largest_cost_stays_the_largest():
    """A step without a finite cost has the record that Ceres gives it."""
    graph = graphs.loop(2, seed=1)
    huge = np.array(graph.measurements)
    huge[3, :2] = 1e160  # its square overflows
    found = bundle.solve(graph.replace(measurements=huge), init="file")
    assert found.summary.termination_type == "FAILURE"
    assert not found.summary.is_solution_usable
