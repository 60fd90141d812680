"""Residuals, their Jacobians and error statistics against formulas and complex-step derivatives."""

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle.model.residuals import (
    linearize,
    reprojection_error,
    reprojection_errors,
    summarize_errors,
)
from tests import scenes

MODELS = sorted(bundle.camera_models())


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 9e-3, 0.011, 1.0, 3.0])
def test_jacobians_agree_with_complex_step(model, angle):
    problem = scenes.make_problem(model=model, num_points=6, seed=5)
    rng = np.random.default_rng(6)
    w = rng.standard_normal((problem.num_images, 3))
    w *= angle / np.linalg.norm(w, axis=1)[:, None]
    analytic = linearize(problem, "algebraic", rotation_offsets=w)
    step = 1e-30

    def derivative(**moved):
        return scenes.residuals(problem, **moved).imag / step

    np.testing.assert_allclose(analytic.residual, scenes.residuals(problem, w=w), atol=1e-8)
    t = problem.cam_from_world[:, 4:]
    for j in range(3):
        delta = 1j * step * np.eye(3)[j]
        for computed, expected in (
            (analytic.d_pose[..., j], derivative(w=w + delta)),
            (analytic.d_pose[..., 3 + j], derivative(w=w, t=t + delta)),
            (analytic.d_point[..., j], derivative(w=w, points=problem.points + delta)),
        ):
            scale = np.abs(expected).max()
            np.testing.assert_allclose(computed, expected, rtol=1e-9, atol=1e-11 * scale)
    for j in range(problem.camera_params.shape[1]):
        delta = 1j * step * np.eye(problem.camera_params.shape[1])[j]
        expected = derivative(w=w, params=problem.camera_params + delta)
        atol = 1e-11 * (1 + np.abs(expected).max())
        np.testing.assert_allclose(analytic.d_params[..., j], expected, rtol=1e-9, atol=atol)


def test_pixels_agree_with_pycolmap_through_pose_and_camera():
    problem = scenes.make_problem(model="OPENCV", seed=7)
    expected = []
    for image, point in zip(problem.observation_image, problem.observation_point, strict=True):
        pose = problem.cam_from_world[image]
        rigid = pycolmap.Rigid3d(pycolmap.Rotation3d(pose[:4]), pose[4:])
        camera = pycolmap.Camera(
            model="OPENCV", width=8, height=6, params=problem.camera_params[image]
        )
        in_camera = rigid.matrix() @ [*problem.points[point], 1]
        expected.append(camera.img_from_cam(in_camera[None])[0])
    residual = linearize(problem).residual
    np.testing.assert_allclose(residual, expected - problem.observation_xy, atol=1e-10)


def test_statistics():
    problem = scenes.make_problem(seed=8)
    norms = np.linalg.norm(scenes.residuals(problem), axis=1)
    error = reprojection_error(problem)
    assert error.rmse == pytest.approx(np.sqrt(np.mean(norms**2)), rel=1e-12)
    assert error.mean == pytest.approx(norms.mean(), rel=1e-12)
    assert error.median == pytest.approx(np.median(norms), rel=1e-12)
    assert error.p95 == pytest.approx(np.percentile(norms, 95), rel=1e-12)
    assert error.max == pytest.approx(norms.max(), rel=1e-12)
    assert error.num_observations == problem.num_observations
    assert error.num_behind_camera == 0


def test_errors_whose_squares_no_double_holds():
    problem = scenes.make_problem()
    xy = problem.observation_xy.copy()
    xy[:2] = [[3e200, -4e200], [-3e200, 4e200]]
    errors, _ = reprojection_errors(problem.replace(observation_xy=xy))
    expected = np.linalg.norm(linearize(problem).residual, axis=1)
    expected[:2] = 5e200
    np.testing.assert_allclose(errors, expected, rtol=1e-14)


@pytest.mark.parametrize(
    ("errors", "median", "p95"),
    [
        ([np.inf] * 3, np.inf, np.inf),
        ([1.0, 2.0, np.inf], 2.0, np.inf),  # between a number and infinity
        ([3.0, np.inf], np.inf, np.inf),
        ([1e308] * 4, 1e308, 1e308),  # their sum is infinite
        ([0.0, 0.0, 1.7e308], 0.0, 1.53e308),
    ],
)
def test_quantiles_of_errors_beyond_what_a_double_holds(errors, median, p95):
    found = summarize_errors(np.array(errors), np.zeros(len(errors), bool), "zero")
    assert (found.median, found.max) == (median, max(errors))
    assert found.p95 == pytest.approx(p95, rel=1e-12)
    assert found.rmse == np.inf


def test_an_unnormalised_quaternion_is_a_rotation_all_the_same():
    problem = scenes.make_problem(seed=9)
    poses = problem.cam_from_world.copy()
    poses[:, :4] *= -3.7
    np.testing.assert_allclose(
        linearize(problem.replace(cam_from_world=poses)).residual,
        linearize(problem).residual,
        atol=1e-9,
    )


def problem_with_a_point_behind():
    problem = scenes.make_problem(seed=10, noise=0)
    points = problem.points.copy()
    behind_first = Rotation.from_quat(problem.cam_from_world[0, :4]).inv()
    points[3] = behind_first.apply([0.3, 0.1, -2.0] - problem.cam_from_world[0, 4:])
    return problem.replace(points=points)


def test_points_behind_the_camera_are_counted_and_cost_what_cheirality_says():
    problem = problem_with_a_point_behind()
    errors, behind = reprojection_errors(problem)
    assert behind[(problem.observation_image == 0) & (problem.observation_point == 3)].all()
    zero = linearize(problem, "zero")
    algebraic = linearize(problem, "algebraic")
    for array in zero:
        assert (array[behind] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(algebraic.residual, axis=1), errors)
    statistics = reprojection_error(problem, "zero")
    assert statistics.num_behind_camera == behind.sum()
    assert statistics.num_observations == problem.num_observations - behind.sum()
    assert reprojection_error(problem, "algebraic").num_observations == problem.num_observations


def test_a_point_in_the_camera_centre_counts_as_nothing():
    problem = scenes.make_problem(seed=11)
    pose = problem.cam_from_world.copy()
    pose[0] = [0, 0, 0, 1, 0, 0, 0]
    points = problem.points.copy()
    points[0] = 0
    problem = problem.replace(cam_from_world=pose, points=points)
    errors, behind = reprojection_errors(problem)
    assert np.isnan(errors[0])
    assert behind[0]
    assert (linearize(problem, "algebraic").residual[0] == 0).all()


def test_no_observations():
    problem = scenes.make_problem(num_points=0)
    error = reprojection_error(problem)
    assert np.isnan(error.rmse)
    assert error.num_observations == 0
