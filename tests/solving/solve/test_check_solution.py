"""Checks at the end of a solve are an option; finding out what is no reconstruction is not."""

import numpy as np
import pytest

import bundle
from tests import scenes
from tests.solving.solve.test_observations_behind import crossing


@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_without_checks_the_solution_is_the_same(backend):
    problem = scenes.make_problem()
    options = {"backend": backend, "deterministic": True}
    checked = bundle.solve(problem, **options)
    unchecked = bundle.solve(problem, check_solution=False, **options)
    np.testing.assert_array_equal(unchecked.problem.points, checked.problem.points)
    assert checked.summary.num_information_nonzeros > 0
    assert unchecked.summary.num_information_nonzeros is None
    unchecked.summary.full_report()


@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_an_impossible_solution_is_found_out_in_any_case(backend):
    """Pixels mirrored at the principal point ask for a negative focal length."""
    problem = scenes.make_problem(model="SIMPLE_PINHOLE", num_points=60, perturbation=1e-3)
    middle = problem.camera_params[0, 1:3]
    mirrored = problem.replace(observation_xy=2 * middle - problem.observation_xy)
    for check in (True, False):
        result = bundle.solve(
            mirrored,
            backend=backend,
            check_solution=check,
            refine=["points", "focal"],
            fixed_point_ids=mirrored.point_ids[1:],
            max_num_iterations=50,
        )
        assert "invalid_solution" in result.summary.warning_kinds
        assert not result.summary.is_solution_usable
        np.testing.assert_array_equal(result.problem.camera_params, mirrored.camera_params)


@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_lost_observations_are_counted_in_any_case(backend):
    options = {"backend": backend, "max_num_iterations": 22, "cheirality": "zero"}
    checked, unchecked = (
        bundle.solve(crossing(), check_solution=check, **options).summary for check in (True, False)
    )
    assert checked.warning_kinds == unchecked.warning_kinds != ()
    assert checked.is_solution_usable == unchecked.is_solution_usable
