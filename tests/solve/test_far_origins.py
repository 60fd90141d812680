"""Scenes far from their origin, and points far from their scene."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

import bundle
from tests import scenes
from tests.figures import warning

UTM = np.array([5e5, 5e6, 300.0])


def moved(problem, offset):
    """The same scene elsewhere: X + c, t - R c."""
    rotations = Rotation.from_quat(problem.cam_from_world[:, :4].copy())
    cam_from_world = problem.cam_from_world.copy()
    cam_from_world[:, 4:] -= rotations.apply(offset)
    return problem.replace(points=problem.points + offset, cam_from_world=cam_from_world)


def centers(problem):
    rotations = Rotation.from_quat(problem.cam_from_world[:, :4].copy())
    return -rotations.inv().apply(problem.cam_from_world[:, 4:].copy())


def size(problem):
    middle = np.median(centers(problem), axis=0)
    return np.median(np.linalg.norm(problem.points - middle, axis=1))


@pytest.fixture
def problem():
    return scenes.make_problem(num_images=11, num_points=60, noise=0.5)


def test_a_scene_far_from_its_origin_is_solved_as_one_near_it(solve, problem):
    near = solve(problem)
    far = solve(moved(problem, UTM))
    assert near.summary.origin is None
    middle = stats.trim_mean(centers(problem), 0.1)
    np.testing.assert_allclose(far.summary.origin, middle + UTM, atol=1e-6)
    assert far.summary.termination_type == "CONVERGENCE"
    np.testing.assert_allclose(far.summary.final_cost, near.summary.final_cost, rtol=1e-6)
    assert len(far.iterations["cost"]) <= len(near.iterations["cost"]) + 2


def test_the_solution_is_in_the_frame_of_the_user(solve, problem):
    far = solve(moved(problem, UTM))
    again = solve(far.problem, max_num_iterations=0).summary
    np.testing.assert_allclose(again.initial_cost, far.summary.final_cost, rtol=1e-6)
    np.testing.assert_allclose(np.median(far.problem.points - UTM, axis=0), 0, atol=0.5)


def test_what_is_not_refined_keeps_its_bits_far_from_the_origin(solve, problem):
    given = moved(problem, UTM)
    images, points = [1, 2], [5, 6, 7]
    refined = solve(
        given,
        fixed_image_ids=given.image_ids[images],
        fixed_point_ids=given.point_ids[points],
        gauge="none",
    ).problem
    np.testing.assert_array_equal(
        refined.cam_from_world[images], given.cam_from_world[images], strict=True
    )
    np.testing.assert_array_equal(refined.points[points], given.points[points])
    assert (refined.points[:5] != given.points[:5]).any(axis=1).all()


def test_without_iterations_every_number_keeps_its_bits(solve, problem):
    given = moved(problem, UTM)
    result = solve(given, max_num_iterations=0)
    assert result.summary.origin is not None
    np.testing.assert_array_equal(result.problem.cam_from_world, given.cam_from_world)
    np.testing.assert_array_equal(result.problem.points, given.points)
    np.testing.assert_array_equal(result.problem.camera_params, given.camera_params)


@pytest.mark.parametrize(("sizes", "is_far"), [(90, False), (110, True)])
def test_a_hundred_times_its_size_away_is_far(problem, sizes, is_far):
    offset = -np.median(centers(problem), axis=0) + [sizes * size(problem), 0, 0]
    summary = bundle.solve(moved(problem, offset), max_num_iterations=0).summary
    assert (summary.origin is not None) == is_far
    assert summary.warning_kinds == ("far_origin",) * is_far


def with_far_point(problem, sizes):
    points = problem.points.copy()
    middle = np.median(centers(problem), axis=0)
    away = points[3] - middle
    points[3] = middle + away / np.linalg.norm(away) * sizes * size(problem)
    return problem.replace(points=points)


@pytest.mark.parametrize("offset", [np.zeros(3), UTM])
def test_a_point_far_away_does_not_end_the_solve(solve, problem, offset):
    options = {"loss": "cauchy", "max_num_iterations": 200}
    best = solve(problem, **options).summary.final_cost
    far = solve(moved(with_far_point(problem, 1e10), offset), **options).summary
    assert not far.message.startswith("Parameter tolerance")
    # The point itself stays wrong: eleven observations.
    assert far.final_cost < best + 11 * 15
    assert f"point {problem.point_ids[3]}" in warning(far, "far_points")


@pytest.mark.parametrize(("sizes", "is_far"), [(900, False), (1100, True)])
def test_a_point_a_thousand_sizes_away_is_far(problem, sizes, is_far):
    summary = bundle.solve(with_far_point(problem, sizes), max_num_iterations=0).summary
    assert summary.warning_kinds == ("far_points",) * is_far


def test_images_far_away_do_not_move_the_centre(problem):
    """Two of eleven are more than the tenth that is left out."""
    poses = moved(problem, UTM).cam_from_world.copy()
    poses[:2, 4:] *= 1e3
    given = moved(problem, UTM).replace(cam_from_world=poses)
    summary = bundle.solve(given, max_num_iterations=0).summary
    np.testing.assert_allclose(summary.origin, UTM, atol=2 * size(problem))


@pytest.mark.parametrize("name", ["bartoszek", "lund_door"])
def test_the_centre_is_where_colmap_puts_the_origin(bundle_data, name):
    problem = bundle.load(bundle_data / "colmap" / name)
    summary = bundle.solve(moved(problem, UTM), max_num_iterations=0).summary
    np.testing.assert_allclose(summary.origin, UTM, atol=1e-6)


def test_a_real_model_in_utm_coordinates(solve, bundle_data):
    problem = bundle.load(bundle_data / "colmap" / "video48")
    near, far = (solve(p).summary for p in (problem, moved(problem, UTM)))
    assert near.origin is None
    assert far.termination_type == "CONVERGENCE"
    np.testing.assert_allclose(far.final_cost, near.final_cost, rtol=1e-6)
    assert far.num_successful_steps == near.num_successful_steps
