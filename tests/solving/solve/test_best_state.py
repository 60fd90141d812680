"""A solve that ends by its limit returns the best state by the cost of all observations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests import scenes


def with_point_behind_an_image(seed):
    """A point closely behind image 3, where it costs nothing; other images see it far away."""
    problem = scenes.make_problem(num_images=6, num_points=50, seed=seed, perturbation=1e-3)
    pose, points = problem.cam_from_world[2], problem.points.copy()
    rotation = Rotation.from_quat(pose[:4]).as_matrix()
    row = int(np.random.default_rng(seed).integers(50))
    points[row] = rotation.T @ (np.array([0.02, 0.03, -0.05]) - pose[4:])
    return problem.replace(points=points)


@pytest.mark.parametrize("backend", ["fused", "ceres"])
@pytest.mark.parametrize("steps", [1, 2, 6])
def test_the_state_is_no_worse_than_the_input(backend, steps):
    """After 1 and 2 steps the start is the best state; after 6 another than the last is."""
    problem = with_point_behind_an_image(23)
    options = {"backend": backend, "cheirality": "zero", "num_threads": 1}
    result = bundle.solve(problem, max_num_iterations=steps, **options)
    assert result.summary.termination_type == "NO_CONVERGENCE"
    before, after = result.reprojection_error_before, result.reprojection_error_after
    if steps < 3:
        assert after.rmse == before.rmse == pytest.approx(226.4271, abs=1e-3)
        assert np.allclose(result.problem.points, problem.points, atol=1e-12)
    else:
        assert after.rmse == pytest.approx(5.6669, abs=1e-3)
    assert result.summary.final_cost != pytest.approx(result.iterations["cost"][-1])
