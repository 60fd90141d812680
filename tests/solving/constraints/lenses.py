"""Scenes with several lenses, and solves to the end of what doubles resolve."""

import numpy as np

import bundle
from tests import scenes

BACKENDS = ("fused", "ceres")
TO_THE_END = {
    "function_tolerance": 1e-16,
    "gradient_tolerance": 0.0,
    "parameter_tolerance": 1e-14,
    "max_num_iterations": 60,
    "linear_solver_type": "dense_schur",
    "gauge": "two_cameras",
    "num_threads": 1,
}
IN_PLACE = {"gauge": "none", "fixed_image_ids": (1, 2)}
"""The world is held: what says where something is has nothing to turn it by."""


def mixed(num_images=5, num_points=30, *, seed=0, **changes):
    """Images 1, 3, ... with SIMPLE_RADIAL, 2, 4, ... with OPENCV, a camera each."""
    problem = scenes.make_problem(num_images=num_images, num_points=num_points, seed=seed)
    params, models = np.zeros((num_images, 8)), list(problem.camera_models)
    params[:, :4] = problem.camera_params
    for image in range(1, num_images, 2):
        focal, x, y, k = problem.camera_params[image]
        params[image, :5], models[image] = [focal, focal + 1, x, y, k], "OPENCV"
    return problem.replace(camera_models=models, camera_params=params, **changes)


def solve(problem, *rules, **options):
    return bundle.solve(problem, constraints=rules, **{**TO_THE_END, **options})


def assert_same(found, expected, tolerance=1e-8):
    """Cost and parameters agree."""
    cost, other = found.summary.final_cost, expected.summary.final_cost
    assert abs(cost - other) <= tolerance * max(abs(other), 1e-3)
    for name in ("cam_from_world", "camera_params", "points"):
        a, b = getattr(found.problem, name), getattr(expected.problem, name)
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance, err_msg=name)
