"""Scenes far from their origin, and points far from their scene."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

import bundle
from tests import scenes
from tests.printed import warning

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
    near, far = (solve(p, convergence="ceres").summary for p in (problem, moved(problem, UTM)))
    assert near.origin is None
    assert far.termination_type == "CONVERGENCE"
    np.testing.assert_allclose(far.final_cost, near.final_cost, rtol=1e-6)
    assert far.num_successful_steps == near.num_successful_steps


def held(problem):
    return {"fixed_point_ids": problem.point_ids[[3]]}


def with_point_out_of_view(problem, sizes):
    """Point 3 far away: in front of every camera, but not where it was observed."""
    points = problem.points.copy()
    points[3] = np.median(centers(problem), axis=0) + np.array([0.3, 0.2, 1]) * sizes * size(
        problem
    )
    return problem.replace(points=points)


@pytest.mark.parametrize("perturbation", [0.01, 0.05])
def test_a_held_point_far_away_is_told_and_its_solution_is_not_usable(solve, perturbation):
    """From the worse start all other points still get better."""
    problem = scenes.make_problem(num_images=11, num_points=60, perturbation=perturbation)
    given = with_point_out_of_view(problem, 1e10)
    summary = solve(given, **held(problem), max_num_iterations=2000).summary
    assert summary.termination_type == "CONVERGENCE"
    assert set(summary.warning_kinds) >= {"far_points", "far_points_dominate"}
    assert f"point {problem.point_ids[3]}" in warning(summary, "far_points")
    assert not summary.is_solution_usable
    assert solve(problem, **held(problem)).summary.is_solution_usable


def test_far_points_that_a_loss_keeps_from_pulling_leave_the_solution_usable(solve):
    """They have nearly all of the cost, and no weight."""
    problem = scenes.make_problem(num_points=30, noise=0.05, perturbation=1e-3)
    given = with_point_out_of_view(problem, 1e10)
    summary = solve(given, **held(problem), loss="cauchy", max_num_iterations=200).summary
    assert "far_points" in summary.warning_kinds
    assert "far_points_dominate" not in summary.warning_kinds
    assert summary.is_solution_usable


def test_a_far_point_that_fits_keeps_the_solution_usable(solve):
    """A far point may well have most of a cost that is all rounding."""
    scene = scenes.make_problem(
        num_images=6, num_points=300, model="PINHOLE", noise=0, perturbation=0
    )
    points = scene.points.copy()
    points[3] = [3000.0, 2000.0, 1e5]
    xy = scene.observation_xy.copy()
    for k in np.flatnonzero(scene.observation_point == 3):
        image = scene.observation_image[k]
        pose = scene.cam_from_world[image]
        in_camera = Rotation.from_quat(pose[:4]).apply(points[3]) + pose[4:]
        params = scene.camera_params[scene.image_camera[image]]
        xy[k] = scenes.project("PINHOLE", params[:4], in_camera[None])[0] + 0.1
    start = scene.points + 1e-3 * (np.arange(300) != 3)[:, None]
    start[3] = points[3]
    far = scene.replace(points=start, observation_xy=xy)
    fixed = {"fixed_point_ids": [far.point_ids[3]], "fixed_image_ids": far.image_ids[1:]}
    summary = solve(far, **fixed, refine=["poses", "points"], gauge="none").summary
    cost = summary.final_cost - summary.fixed_cost
    # Linear algebra: the pose takes a share h of the one residual that is not all held, and the
    # others pay for it. They leave (1 - h) of its cost, of which 1 - h is its own.
    assert 0.5 < cost / (0.5 * 2 * 0.1**2) < 1
    assert summary.warning_kinds == ("far_points",)
    assert summary.is_solution_usable


def test_without_iterations_nothing_is_judged(solve, problem):
    given = with_point_out_of_view(problem, 1e10)
    summary = solve(given, **held(problem), max_num_iterations=0).summary
    assert summary.warning_kinds == ("far_points",)
    assert summary.is_solution_usable


def test_far_points_of_held_images_take_no_part(solve, problem):
    """Nothing is refined by them."""
    given = with_point_out_of_view(problem, 1e10)
    keep = (given.observation_point != 3) | (given.observation_image == 0)
    given = given.replace(
        observation_xy=given.observation_xy[keep],
        observation_image=given.observation_image[keep],
        observation_point=given.observation_point[keep],
        observation_keypoint=given.observation_keypoint[keep],
    )
    fixed = {"fixed_image_ids": given.image_ids[:3], "fixed_camera_ids": given.camera_ids[:3]}
    summary = solve(given, **held(problem), **fixed, gauge="none").summary
    assert summary.warning_kinds == ()
    assert summary.is_solution_usable


@pytest.mark.parametrize("options", [{}, {"loss": "huber"}])
def test_a_world_follows_a_held_point_far_away(solve, bundle_data, options):
    """Only what the point leaves free is held, so that the others fit nearly as well."""
    problem = bundle.load(bundle_data / "colmap" / "bartoszek")
    points = problem.points.copy()
    points[100] = 1e10
    far = problem.replace(points=points)
    known = {"fixed_point_ids": [far.point_ids[100]], **options}
    summary = solve(far, **known).summary
    assert "far_points" in summary.warning_kinds
    assert "far_points_dominate" not in summary.warning_kinds
    best = solve(problem, **known).summary.final_cost
    assert best < summary.final_cost < 2 * best
