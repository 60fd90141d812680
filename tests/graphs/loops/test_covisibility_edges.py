"""Edges between images that share points: which there are, and what they know."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.graphs.loops.covisibility_edges import (
    MIN_SHARED,
    MOST_NEIGHBOURS,
    covisibility_edges,
    fitting_observations,
)
from tests.scenes import make_problem, with_observations


def pair(num_points):
    return make_problem(
        num_images=2, num_points=num_points, model="PINHOLE", noise=0.0, perturbation=0.0
    )


def with_misses(shared, num_good):
    """Return images 0 and 1 that share points, the first of which fit; two others see many."""
    problem = make_problem(num_images=4, num_points=60, noise=0.0, perturbation=0.0)
    image, point = problem.observation_image, problem.observation_point
    problem = with_observations(problem, (image > 1) | (point < shared))
    image, point = problem.observation_image, problem.observation_point
    xy = problem.observation_xy.copy()
    bad = (point >= num_good) & (image < 2)
    xy[bad, 1] += np.where(image[bad] == 0, 60.0, -60.0)
    return problem.replace(observation_xy=xy), ~bad


@pytest.mark.parametrize(("shared", "is_edge"), [(12, True), (13, False)])
def test_half_of_the_shared_points_have_to_count(shared, is_edge):
    edges = covisibility_edges(*with_misses(shared, MIN_SHARED))
    mine = (edges.pairs == [0, 1]).all(axis=1)
    assert edges.num_shared[mine].tolist() == ([MIN_SHARED] if is_edge else [])


@pytest.mark.parametrize("shared", [MIN_SHARED - 1, MIN_SHARED])
def test_fewer_points_make_no_edge(shared):
    problem = pair(shared)
    edges = covisibility_edges(problem, np.ones(problem.num_observations, bool))
    assert len(edges.pairs) == (shared >= MIN_SHARED)


def test_points_that_do_not_fit_count_where_their_rays_meet():
    problem = pair(8)
    shifted = problem.replace(points=problem.points + np.array([0.0, 0.0, 3.0]))
    edges = covisibility_edges(shifted, np.zeros(problem.num_observations, bool))
    assert edges.num_shared.tolist() == [8]
    true = covisibility_edges(problem, np.ones(problem.num_observations, bool))
    np.testing.assert_allclose(edges.information, true.information, rtol=1e-6)


@pytest.mark.parametrize(("sine", "num_edges"), [(0.03, 1), (0.01, 0)])
def test_rays_that_are_nearly_parallel_tell_no_place(sine, num_edges):
    """Both cameras look at points far away; nothing of the model explains the pixels."""
    problem = pair(8)
    poses = np.tile([0, 0, 0, 1.0, 0, 0, 0], (2, 1))
    poses[1, 4] = -1.0
    points = np.column_stack([problem.points[:, :2], np.full(8, 1 / sine)])
    at = _projected(problem.replace(cam_from_world=poses, points=points))
    edges = covisibility_edges(at, np.zeros(16, bool))
    assert len(edges.pairs) == num_edges


def test_information_is_the_curvature_of_what_both_images_see():
    """W by numerical differentiation of the pixels, in the middle of the image."""
    problem = pair(9)
    middle = problem.points.mean(axis=0)
    small = _projected(problem.replace(points=middle + 0.02 * problem.points))
    edges = covisibility_edges(small, np.ones(small.num_observations, bool))
    expected = np.zeros((7, 7))
    turns = Rotation.from_quat(small.cam_from_world[:, :4])
    shifts = small.cam_from_world[:, 4:]
    for x_world in np.array(small.points):
        x = turns[1].apply(x_world) + shifts[1]
        jacobian = np.zeros((4, 7))
        for k in range(7):
            ends = []
            for sign in (1, -1):
                d = np.zeros(7)
                d[k] = sign * 1e-5
                moved = np.exp(d[6]) * Rotation.from_rotvec(d[:3]).apply(x) + d[3:6]
                world = turns[1].inv().apply(moved - shifts[1])
                pixels = []
                for image in (0, 1):
                    at = turns[image].apply(world) + shifts[image]
                    focal = small.camera_params[small.image_camera[image], 0]
                    pixels += (focal * at[:2] / at[2]).tolist()
                ends.append(np.array(pixels))
            jacobian[:, k] = (ends[0] - ends[1]) / 2e-5
        expected += jacobian.T @ jacobian
    # A track of two images: (2 * 2 - 3) / 4 for its one pair.
    np.testing.assert_allclose(
        edges.information[0], expected / 4, atol=0.02 * np.abs(expected).max()
    )


def _projected(problem):
    image, point = problem.observation_image, problem.observation_point
    turn = Rotation.from_quat(problem.cam_from_world[image, :4])
    at = turn.apply(problem.points[point]) + problem.cam_from_world[image, 4:]
    params = problem.camera_params[problem.image_camera[image]]
    return problem.replace(observation_xy=params[:, :2] * at[:, :2] / at[:, 2:] + params[:, 2:4])


def test_long_tracks_pair_with_the_next_images_only():
    problem = make_problem(num_images=14, num_points=8, noise=0.0, perturbation=0.0)
    edges = covisibility_edges(problem, np.ones(problem.num_observations, bool))
    low, high = edges.pairs.T
    assert (high - low).max() == MOST_NEIGHBOURS
    assert len(edges.pairs) == sum(min(MOST_NEIGHBOURS, 13 - k) for k in range(14))
    assert (edges.num_shared == 8).all()
    # Information that a track brings does not grow with its pairs: 2 n - 3 of 4 p numbers.
    pairs = len(edges.pairs)
    two = with_observations(problem, problem.observation_image < 2)
    alone = covisibility_edges(two, np.ones(two.num_observations, bool)).information[0]
    shared = edges.information[(low == 0) & (high == 1)][0]
    np.testing.assert_allclose(shared, alone * 4 * (2 * 14 - 3) / (4 * pairs), rtol=1e-12)


def test_observations_fit_within_five_medians_or_four_pixels():
    problem = pair(40)
    xy = problem.observation_xy.copy()
    assert fitting_observations(problem).all()
    xy[0, 0] += 3.9
    xy[1, 0] += 4.1
    fits = fitting_observations(problem.replace(observation_xy=xy))
    assert np.flatnonzero(~fits).tolist() == [1]
    rough = problem.observation_xy + np.array([2.0, 0.0])
    rough[0, 0] += 7.9
    rough[1, 0] += 8.1
    fits = fitting_observations(problem.replace(observation_xy=rough))
    assert np.flatnonzero(~fits).tolist() == [1]
    sigma = np.full(80, 0.5)
    noisy = covisibility_edges(problem.replace(observation_sigma=sigma), np.ones(80, bool))
    plain = covisibility_edges(problem, np.ones(80, bool))
    np.testing.assert_allclose(noisy.information, 4 * plain.information, rtol=1e-12)
