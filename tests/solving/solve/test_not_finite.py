"""Costs and gradients beyond what a double holds: a failure, on both backends."""

import math

import numpy as np
import pytest

from tests import scenes


def test_a_gradient_that_is_no_number_is_no_convergence(solve, backend):
    """0 times infinity in Ceres' arctan; Ceres takes it for a gradient below the tolerance."""
    result = solve(scenes.make_problem(), loss="arctan", loss_scale=1e-100)
    gradient = result.iterations["gradient_max_norm"][-1]
    if backend == "ceres":
        assert math.isnan(gradient)
    is_number = bool(np.isfinite(gradient))
    assert result.summary.is_solution_usable == is_number
    assert (result.summary.termination_type == "FAILURE") != is_number


@pytest.mark.parametrize("far", [1e154, 1e160])
def test_a_cost_that_overflows_is_no_convergence(solve, far):
    problem = scenes.make_problem()
    summary = solve(problem.replace(observation_xy=problem.observation_xy + far)).summary
    assert summary.termination_type == "FAILURE"
    assert not summary.is_solution_usable
    assert "residual_not_finite" in summary.warning_kinds
