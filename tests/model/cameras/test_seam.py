"""The residual of a panorama across its seam, and its width and height that nothing refines."""

import numpy as np
import pytest

import bundle
from bundle.model.residuals import linearize, reprojection_errors
from tests import scenes


def panoramas(**changes):
    """Every camera looks away from the scene, so that the scene lies around the seam."""
    problem = scenes.make_problem(model="EQUIRECTANGULAR", seed=3, num_images=4)
    poses = problem.cam_from_world.copy()
    half_turn = np.array([0, 1, 0, 0.0])  # about y
    x, y, z, w = poses[:, :4].T
    a, b, c, d = half_turn
    poses[:, :4] = np.stack(
        [
            d * x + a * w + b * z - c * y,
            d * y - a * z + b * w + c * x,
            d * z + a * y - b * x + c * w,
            d * w - a * x - b * y - c * z,
        ],
        1,
    )
    poses[:, 4:] *= [-1, 1, -1]
    width = problem.camera_params[problem.image_camera[problem.observation_image], 0]
    xy = problem.observation_xy.copy()
    xy[:, 0] = (xy[:, 0] + width / 2) % width
    return problem.replace(**{"cam_from_world": poses, "observation_xy": xy, **changes})


def test_errors_and_residuals_are_short_across_the_seam():
    problem = panoramas()
    width = problem.camera_params[problem.image_camera[problem.observation_image], 0]
    x = problem.observation_xy[:, 0]
    assert (x < 0.2 * width).any()
    assert (x > 0.8 * width).any()
    straight = scenes.make_problem(model="EQUIRECTANGULAR", seed=3, num_images=4)
    expected = linearize(straight)
    found = linearize(problem)
    np.testing.assert_allclose(found.residual, expected.residual, atol=1e-9)
    np.testing.assert_allclose(found.d_point, expected.d_point, rtol=1e-9, atol=1e-9)
    errors, behind = reprojection_errors(problem)
    np.testing.assert_allclose(errors, np.linalg.norm(expected.residual, axis=1), atol=1e-9)
    assert not behind.any()


def test_half_a_turn_off_has_the_sign_that_colmap_gives_it():
    """The residual lies in [-w/2, w/2)."""
    problem = panoramas()
    width = problem.camera_params[problem.image_camera[problem.observation_image], 0]
    xy = problem.observation_xy + linearize(problem).residual  # what is projected, modulo w
    for turn, expected in ((0.5, -0.5), (-0.5, -0.5), (0.25, 0.25), (0.75, -0.25), (3.0, 0.0)):
        moved = problem.replace(observation_xy=xy - np.stack([turn * width, 0 * width], 1))
        residual = linearize(moved).residual[:, 0] / width
        slack = 1e-9 if abs(turn) != 0.5 else 1.0 + 1e-9
        np.testing.assert_allclose(residual, expected, rtol=0, atol=slack)
        assert (residual >= -0.5).all()
        assert (residual < 0.5).all()


def test_a_solve_does_not_see_the_seam(solve):
    options = {"linear_solver_type": "dense_schur", "function_tolerance": 1e-12}
    straight = solve(scenes.make_problem(model="EQUIRECTANGULAR", seed=3, num_images=4), **options)
    across = solve(panoramas(), **options)
    assert across.summary.final_cost == pytest.approx(straight.summary.final_cost, rel=1e-9)
    assert across.summary.final_cost < 0.1 * across.summary.initial_cost


@pytest.mark.parametrize("shared", [False, True])
def test_width_and_height_are_never_refined(solve, shared):
    problem = scenes.make_problem(model="EQUIRECTANGULAR", seed=4, shared=shared)
    assert bundle.model.cameras.param_kinds("EQUIRECTANGULAR") == ("metadata", "metadata")
    result = solve(problem, refine="poses,points,focal,principal-point,extra")
    np.testing.assert_array_equal(result.problem.camera_params, problem.camera_params)
    assert result.summary.final_cost < 0.1 * result.summary.initial_cost


@pytest.mark.parametrize("size", [0.0, -2.0])
def test_width_and_height_must_be_positive(solve, size):
    problem = scenes.make_problem(model="EQUIRECTANGULAR", seed=4)
    params = problem.camera_params.copy()
    params[2, 1] = size
    with pytest.raises(
        bundle.InputError, match=f"camera 3: expected a positive image size h, found {size:g}"
    ):
        solve(problem.replace(camera_params=params))


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 3])
def test_the_derivative_by_the_width_counts_the_turns(turns):
    """A turn across the seam is a width long: by central differences of the residual."""
    problem = panoramas()
    width = problem.camera_params[problem.image_camera[problem.observation_image], 0]
    xy = problem.observation_xy + np.stack([turns * width, 0 * width], axis=1)
    problem = problem.replace(observation_xy=xy)
    found = linearize(problem)
    sides = []
    for step in (1e-4, -1e-4):
        params = np.array(problem.camera_params)
        params[:, 0] += step
        sides.append(linearize(problem.replace(camera_params=params)).residual)
    expected = (sides[0] - sides[1]) / 2e-4
    np.testing.assert_allclose(found.d_params[:, :, 0], expected, atol=1e-6)
    near = np.abs(found.residual[:, 0]) < 0.1 * width
    assert near.all() and (np.abs(found.d_params[:, 0, 0] - found.d_params[0, 0, 0]) > 0.5).any()


@pytest.mark.parametrize("x", [5.0, 995.0, 1005.0, 1995.0, 2005.0, -1995.0])
def test_a_factor_has_the_derivatives_of_its_residual_on_either_side_of_the_seam(x):
    graph = bundle.FactorGraph()
    graph.add_variable("pose", [0.1, -0.2, 0.05, 0.97, 0.02, 0, 0.1], "se3")
    graph.add_variable("camera", [2000.0, 1000.0])
    graph.add_variable("point", [0.05, 0.1, -1.0])
    graph.add_factor(
        bundle.ReprojectionFactor("pose", "camera", "point", [x, 500.0], "EQUIRECTANGULAR")
    )
    report = graph.check_gradients()
    assert report.verdict == "correct", str(report)
