"""Lengths of steps: those of both backends, of accepted and rejected steps, with any Ceres."""

import numpy as np
import pytest

import bundle
from tests.scenes import scene

RUNNING = {"max_num_iterations": 6, "function_tolerance": 0.0, "gradient_tolerance": 0.0}


@pytest.mark.parametrize("strategy", ["levenberg_marquardt", "dogleg"])
@pytest.mark.parametrize("move", [1e-3, 1.0])
def test_steps_have_the_length_that_they_move_the_numbers(strategy, move):
    """The first step counts too. It moves the poses by what their translations show; a start far
    away makes steps that are rejected."""
    rng = np.random.default_rng(1)
    problem = scene()
    problem = problem.replace(points=problem.points + move * rng.normal(size=problem.points.shape))
    told = []
    runs = [
        bundle.solve(
            problem,
            backend=backend,
            trust_region_strategy_type=strategy,
            linear_solver_type="dense_schur",
            progress=lambda record: told.append(record["step_norm"]),
            **RUNNING,
        ).iterations
        for backend in ("fused", "ceres")
    ]
    steps = [run["step_norm"][:4] for run in runs]
    np.testing.assert_allclose(steps[1], steps[0], rtol=1e-6)
    assert (steps[1][1:] > 0).all() and steps[1][0] == 0
    assert told == [*runs[0]["step_norm"], *runs[1]["step_norm"]]


def test_steps_of_graphs():
    graph = bundle.FactorGraph()
    graph.add_variable("a", [3.0, 4.0])
    graph.add_factor(bundle.PriorFactor("a", [0.0, 0.0], np.eye(2)))
    lengths = graph.solve().iterations["step_norm"]
    assert lengths[0] == 0
    assert lengths[1] == pytest.approx(5, rel=1e-3)
