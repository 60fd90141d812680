"""Images with camera models of different sizes: records and blocks as wide as each needs."""

import numpy as np
import pytest

import bundle
from tests import scenes


def with_full_opencv(problem, images):
    """The same lenses, those of some images as FULL_OPENCV."""
    params = np.zeros((problem.num_cameras, 12))
    params[:, :4] = problem.camera_params
    models = list(problem.camera_models)
    for image in images:
        focal, x, y, k = problem.camera_params[image]
        params[image] = [focal, focal, x, y, k, *np.zeros(7)]
        models[image] = "FULL_OPENCV"
    return problem.replace(camera_models=models, camera_params=params)


@pytest.mark.parametrize("wide", [[0], [2], [1, 5]])
def test_images_of_different_widths_take_the_steps_of_ceres(wide):
    problem = with_full_opencv(scenes.make_problem(num_images=6, num_points=60), wide)
    fused, ceres = (
        bundle.solve(
            problem, backend=backend, linear_solver_type="dense_schur", max_num_iterations=4
        ).iterations["cost"]
        for backend in ("fused", "ceres")
    )
    np.testing.assert_allclose(fused, ceres, rtol=1e-9)


def test_points_that_are_spread_over_several_chunks():
    """So many pairs that a chunk has some rows of one point only."""
    problem = with_full_opencv(scenes.make_problem(num_images=280, num_points=6), range(0, 280, 30))
    fused, ceres = (
        bundle.solve(
            problem,
            backend=backend,
            linear_solver_type="dense_schur",
            max_num_iterations=2,
            refine=["points", "focal", "extra"],
        ).iterations["cost"]
        for backend in ("fused", "ceres")
    )
    np.testing.assert_allclose(fused, ceres, rtol=1e-9)


def test_their_blocks_precondition_conjugate_gradients():
    problem = with_full_opencv(scenes.make_problem(num_images=6, num_points=60), [2])
    iterative, dense = (
        bundle.solve(
            problem,
            backend="fused",
            linear_solver_type=solver,
            preconditioner_type="jacobi",
            max_num_iterations=200,
            function_tolerance=1e-12,
        ).summary.final_cost
        for solver in ("iterative_schur", "dense_schur")
    )
    np.testing.assert_allclose(iterative, dense, rtol=1e-4)
