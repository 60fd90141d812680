"""Distortion curves and the frame of the 3-D view against formulas of their own."""

import numpy as np
import pytest

from bundle.figures.lens_figures import lens_curve, most_observed_cameras
from bundle.figures.scene_view import scene_view
from bundle.model.residuals import residuals
from tests.formulas import PARAMS
from tests.scenes import make_problem


def lens(model, params, size=(800, 600)):
    problem = make_problem(num_images=2, num_points=40, model=model, shared=True)
    return problem.replace(camera_params=[params], camera_sizes=[size])


def test_a_radial_lens_has_the_curve_of_its_polynomial():
    f, k = 500.0, -0.1
    curve = lens_curve(lens("SIMPLE_RADIAL", [f, 400.0, 300.0, k]), 0)
    u = np.linspace(0, 2, 20_001)
    radius = f * u * (1 + k * u**2)
    expected = np.interp(curve.radius, radius, f * k * u**3)
    np.testing.assert_allclose(curve.distortion, expected, atol=1e-3)
    assert curve.corner_radius == pytest.approx(500.0)
    assert 480 < curve.radius[-1] <= 500 and curve.radius[0] == curve.distortion[0] == 0
    assert np.isnan(curve.fold_radius)


def test_a_fold_inside_the_image_is_found():
    f, k = 500.0, -0.4
    curve = lens_curve(lens("SIMPLE_RADIAL", [f, 400.0, 300.0, k]), 0)
    u = np.sqrt(-1 / (3 * k))  # where the derivative of u + k u^3 is zero
    assert curve.fold_radius == pytest.approx(f * u * (1 + k * u**2), rel=1e-3)


def test_two_focal_lengths_without_distortion_have_none():
    curve = lens_curve(lens("PINHOLE", [500.0, 450.0, 400.0, 300.0]), 0)
    np.testing.assert_allclose(curve.distortion, 0.0, atol=1e-9)


def test_a_fisheye_is_compared_to_theta():
    params = [300.0, 400.0, 300.0, 0.02]
    curve = lens_curve(lens("SIMPLE_RADIAL_FISHEYE", params), 0)
    theta = np.linspace(0, 2.3, 20_001)
    radius = 300 * theta * (1 + 0.02 * theta**2)
    expected = np.interp(curve.radius, radius, 300 * 0.02 * theta**3)
    np.testing.assert_allclose(curve.distortion, expected, atol=1e-3)


def test_terms_that_are_not_symmetric_cancel():
    straight = lens_curve(lens("OPENCV", [500.0, 500.0, 400.0, 300.0, -0.1, 0.01, 0.0, 0.0]), 0)
    skewed = lens_curve(lens("OPENCV", [500.0, 500.0, 400.0, 300.0, -0.1, 0.01, 1e-3, 2e-3]), 0)
    again = np.interp(straight.radius, skewed.radius, skewed.distortion)
    np.testing.assert_allclose(again, straight.distortion, atol=0.02)
    assert np.abs(straight.distortion).max() > 10


def test_the_band_is_that_of_the_derivatives():
    f, k = 500.0, -0.1
    covariance = np.full((4, 4), np.nan)
    known = np.array([[4.0, 1e-3], [1e-3, 1e-6]])
    covariance[np.ix_([0, 3], [0, 3])] = known
    curve = lens_curve(lens("SIMPLE_RADIAL", [f, 400.0, 300.0, k]), 0, covariance)
    u = np.linspace(0, 2, 20_001)
    at = np.interp(curve.radius, f * u * (1 + k * u**2), u)
    gradient = np.stack([k * at**3, f * at**3])
    expected = np.sqrt(np.einsum("in,ij,jn->n", gradient, known, gradient))
    np.testing.assert_allclose(curve.sigma, expected, rtol=1e-4, atol=1e-7)


def test_the_observed_radius_is_that_of_the_farthest_observation():
    problem = make_problem(num_images=3, num_points=30)
    number = np.bincount(problem.observation_image)
    assert number[most_observed_cameras(problem)].tolist() == sorted(number.tolist())[::-1]
    curve = lens_curve(problem, 1)
    xy = problem.observation_xy[problem.observation_image == 1]
    offset = xy - PARAMS["SIMPLE_RADIAL"][1:3]
    assert curve.observed_radius == pytest.approx(np.hypot(*offset.T).max())


def test_the_view_has_every_camera_and_point_where_it_is():
    problem = make_problem(num_images=5, num_points=50)
    far = problem.points.copy()
    far[7] = [1e7, 0, 0]
    problem = problem.replace(points=far)
    found = residuals(problem)
    view = scene_view(problem, found)
    assert (view.step, view.num_far) == (1, 1)
    assert view.point_indices.tolist() == [i for i in range(50) if i != 7]
    world = view.origin + view.unit * view.points
    np.testing.assert_allclose(world, problem.points[view.point_indices], atol=1e-9)
    world = view.origin + view.unit * view.centers
    np.testing.assert_allclose(world, problem.projection_centers, atol=1e-9)
    mine = found.lengths[(problem.observation_point == 3) & found.counted]
    assert view.point_errors[3] == pytest.approx(np.sqrt((mine**2).mean()))
    np.testing.assert_allclose(np.linalg.norm([view.up, view.forward], axis=1), 1.0)
    assert view.up @ view.forward == pytest.approx(0.0, abs=1e-12)
    assert view.up @ [0, -1, 0] > 0.9  # images are upright, y down


def test_up_is_z_where_the_world_says_so():
    view = scene_view(make_problem(), None, z_is_up=True)
    assert view.up.tolist() == [0.0, 0.0, 1.0]
    assert view.forward @ view.up == 0.0


def test_every_kth_point_is_drawn_of_many():
    problem = make_problem(num_images=1, num_points=2)
    many = np.random.default_rng(0).normal(size=(150_001, 3))
    view = scene_view(problem.replace(points=many, point_ids=np.arange(150_001)), None)
    assert view.step == 3
    assert view.point_indices.tolist() == list(range(0, 150_001, 3))
    assert np.isnan(view.point_errors).all()
