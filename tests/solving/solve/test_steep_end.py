"""Ends by parameter tolerance or radius where the cost could still fall: a warning."""

import numpy as np
import pytest

import bundle
from tests import scenes

MODELS = ["PINHOLE", "SIMPLE_RADIAL", "OPENCV", "OPENCV_FISHEYE", "EUCM", "FOV"]


@pytest.mark.parametrize("model", MODELS)
def test_a_loose_parameter_tolerance_is_no_minimum(solve, model):
    problem = scenes.make_problem(model=model, shared=True, perturbation=0.03)
    loose = solve(problem, parameter_tolerance=0.1, function_tolerance=0.0)
    assert loose.summary.message.startswith("Parameter tolerance")
    assert loose.summary.warning_kinds == ("steep_end",)
    tight = solve(problem, parameter_tolerance=1e-9, function_tolerance=0.0)
    assert tight.summary.warning_kinds == ()
    assert tight.summary.final_cost < loose.summary.final_cost


@pytest.mark.parametrize("strategy", ["levenberg_marquardt", "dogleg", "subspace_dogleg"])
@pytest.mark.parametrize("noise", [0.0, 1e-9, 0.5])
def test_a_minimum_is_not_accused(solve, strategy, noise):
    """Without noise all of the cost is rounding, and so is what a step would gain."""
    for seed in range(3):
        problem = scenes.make_problem(seed=seed, noise=noise, num_points=25)
        for settings in (
            {"function_tolerance": 0.0, "gradient_tolerance": 0.0},
            {"function_tolerance": 0.0, "gradient_tolerance": 0.0, "parameter_tolerance": 0.0},
        ):
            result = solve(problem, trust_region_strategy_type=strategy, **settings)
            assert "steep_end" not in result.summary.warning_kinds
            again = solve(result.problem, trust_region_strategy_type=strategy, **settings)
            assert "steep_end" not in again.summary.warning_kinds


def kink(step):
    """A cost that jumps up below x = 1, where its gradient points."""

    def function(values):
        x = values[0][0]
        return [x + (step if x < 1 else 0.0)], [[[1.0]]]

    return function


@pytest.mark.parametrize("square_root", [False, True])
def test_a_jump_in_a_graph_stops_it_on_a_slope(square_root):
    graph = bundle.FactorGraph()
    graph.add_variable("x", [3.0])
    graph.add_factor(bundle.FunctionFactor(["x"], kink(5.0)))
    result = graph.solve(
        square_root=square_root,
        function_tolerance=0.0,
        gradient_tolerance=0.0,
        max_num_iterations=500,
    )
    assert result.summary.termination_type == "CONVERGENCE"
    assert "steep_end" in result.summary.warning_kinds
    smooth = bundle.FactorGraph()
    smooth.add_variable("x", [3.0])
    smooth.add_factor(bundle.FunctionFactor(["x"], kink(0.0)))
    ended = smooth.solve(square_root=square_root, function_tolerance=0.0)
    assert "steep_end" not in ended.summary.warning_kinds


def test_a_gradient_against_a_bound_is_none():
    problem = scenes.make_problem(shared=True)
    params = problem.camera_params.copy()
    params[0, 0] += 40
    lower = np.array([params[0, 0] - 10, -np.inf, -np.inf, -np.inf])
    result = bundle.solve(
        problem.replace(camera_params=params),
        bounds={("camera", 1): (lower, np.full(4, np.inf))},
        function_tolerance=0.0,
    )
    assert "steep_end" not in result.summary.warning_kinds
