"""The part of observations whose normal equations stay small."""

import numpy as np

import bundle
from bundle.model.point_elimination import part_of_observations


def street():
    return bundle.synthesize(scene="street", num_images=40, num_points=600, seed=1).problem


def test_a_small_problem_takes_part_except_points_in_one_image():
    problem = street()
    rows = np.flatnonzero(problem.observation_image < 20)
    part = part_of_observations(problem, rows, 100, 10_000)
    tracks = np.bincount(problem.observation_point[rows], minlength=problem.num_points)
    np.testing.assert_array_equal(part, np.flatnonzero(tracks[problem.observation_point[rows]] > 1))


def test_the_images_are_those_that_share_most_points_with_the_richest():
    problem = street()
    rows = np.arange(problem.num_observations)
    image, point = problem.observation_image, problem.observation_point
    richest = np.argmax(np.bincount(image))
    shared = [len(np.intersect1d(point[image == k], point[image == richest])) for k in range(40)]
    chosen = np.unique(image[part_of_observations(problem, rows, 8, 10_000)])
    assert richest in chosen
    assert len(chosen) == 8
    assert min(np.array(shared)[chosen]) >= sorted(shared)[-8]


def test_points_are_spread_over_all():
    problem = street()
    rows = np.arange(problem.num_observations)
    part = part_of_observations(problem, rows, 100, 50)
    points = np.unique(problem.observation_point[part])
    assert len(points) == 50
    assert points[0] < problem.num_points / 20
    assert points[-1] > problem.num_points * 19 / 20
