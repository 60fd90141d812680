"""Perturbed starts: seeded, of the given size, and only of what a solve refines."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.interface.options import SolveOptions
from bundle.model.rigid_motions import inverse_poses
from bundle.planning.comparison.work import perturbed
from tests.rig_scenes import rig_problem
from tests.scenes import make_problem

SIZE = 0.01
EVERYTHING = SolveOptions()


def angles(problem, other):
    """Angle between the rotations of all images, in radians."""
    dot = np.abs((problem.cam_from_world[:, :4] * other.cam_from_world[:, :4]).sum(axis=1))
    return 2 * np.arccos(np.minimum(dot, 1))


def test_sizes_are_relative_to_distances():
    problem = make_problem(num_images=40, num_points=2000)
    moved = perturbed(problem, EVERYTHING, SIZE, seed=3)
    image, point = problem.observation_image, problem.observation_point
    distance = np.linalg.norm(problem.points[point] - problem.projection_centers[image], axis=1)
    nearest = np.full(problem.num_points, np.inf)
    np.minimum.at(nearest, point, distance)
    shift = (moved.points - problem.points) / nearest[:, None]
    assert np.sqrt((shift**2).mean()) == pytest.approx(SIZE, rel=0.05)
    middle = np.array([np.median(distance[image == k]) for k in range(problem.num_images)])
    shift = (moved.projection_centers - problem.projection_centers) / middle[:, None]
    assert np.sqrt((shift**2).mean()) == pytest.approx(SIZE, rel=0.2)
    assert np.sqrt((angles(problem, moved) ** 2).mean() / 3) == pytest.approx(SIZE, rel=0.2)


def test_scale_of_the_scene_does_not_matter():
    problem = make_problem(num_images=6, num_points=50)
    scaled = dataclasses.replace(
        problem,
        points=1000 * problem.points,
        cam_from_world=problem.cam_from_world * np.array([1, 1, 1, 1, 1e3, 1e3, 1e3]),
    )
    one, other = (
        bundle.solve(perturbed(given, EVERYTHING, SIZE, 5), max_num_iterations=0)
        for given in (problem, scaled)
    )
    assert one.summary.initial_cost == pytest.approx(other.summary.initial_cost, rel=1e-9)


def test_seed_decides():
    problem = make_problem(num_images=6, num_points=50)
    one, same, other = (perturbed(problem, EVERYTHING, SIZE, seed) for seed in (1, 1, 2))
    assert np.array_equal(one.points, same.points)
    assert np.array_equal(one.cam_from_world, same.cam_from_world)
    assert not np.isclose(one.points, other.points).any(axis=1).all()


def test_constant_values_stay():
    problem = make_problem(num_images=6, num_points=50)
    fixed = SolveOptions(
        fixed_image_ids=(int(problem.image_ids[2]),),
        fixed_point_ids=tuple(problem.point_ids[7:9].tolist()),
        fixed_camera_ids=(int(problem.camera_ids[3]),),
    )
    moved = perturbed(problem, fixed, SIZE, 0)
    assert np.array_equal(moved.cam_from_world[2], problem.cam_from_world[2])
    assert (moved.cam_from_world[[0, 1, 3]] != problem.cam_from_world[[0, 1, 3]]).any(axis=1).all()
    same = (moved.points == problem.points).all(axis=1)
    assert np.flatnonzero(same).tolist() == [7, 8]
    same = (moved.camera_params == problem.camera_params).all(axis=1)
    assert np.flatnonzero(same).tolist() == [3]
    poses = perturbed(problem, SolveOptions(refine=("poses",)), SIZE, 0)
    assert np.array_equal(poses.points, problem.points)
    assert np.array_equal(poses.camera_params, problem.camera_params)
    # The other random numbers do not depend on what is constant.
    everything = perturbed(problem, EVERYTHING, SIZE, 0)
    assert np.array_equal(poses.cam_from_world, everything.cam_from_world)


def test_frames_move_and_sensors_stay():
    problem = rig_problem()
    moved = perturbed(problem, EVERYTHING, SIZE, 0)
    assert np.array_equal(moved.sensor_from_rig, problem.sensor_from_rig)
    assert (moved.rig_from_world != problem.rig_from_world).any(axis=1).all()
    assert bundle.solve(moved).summary.final_cost == pytest.approx(
        bundle.solve(problem).summary.final_cost, rel=1e-4
    )


def test_rotation_is_about_the_centre():
    problem = make_problem(num_images=6, num_points=50)
    moved = perturbed(problem, EVERYTHING, 1e-9, 0)
    before, after = (inverse_poses(p.cam_from_world)[:, 4:] for p in (problem, moved))
    assert np.abs(after - before).max() < 1e-7


def test_a_start_at_its_minimum_is_one_no_more():
    solved = bundle.solve(make_problem(num_images=6, num_points=50))
    start = bundle.solve(perturbed(solved.problem, EVERYTHING, SIZE, 0))
    assert start.summary.initial_cost > 5 * solved.summary.final_cost
    assert start.summary.final_cost == pytest.approx(solved.summary.final_cost, rel=1e-5)


def test_points_and_images_without_observations_stay():
    problem = make_problem(num_images=4, num_points=20)
    kept = (problem.observation_image != 3) & (problem.observation_point != 5)
    bare = problem.select(observations=kept).problem
    moved = perturbed(bare, EVERYTHING, SIZE, 0)
    assert np.isfinite(moved.points).all() and np.isfinite(moved.cam_from_world).all()
