"""From where on something looks wrong: each bound from both sides."""

from __future__ import annotations

import numpy as np
import pytest

import bundle
from bundle.analysis.diagnosis.track_table import covisibility
from bundle.analysis.statistics.description import describe
from bundle.analysis.statistics.suspicions import (
    broken_parts,
    collapsed_observations,
    depths_of_observations,
    summarize,
    suspicions,
)
from tests.scenes import scene


def kinds(problem):
    return {suspicion.kind for suspicion in describe(problem).suspicions}


@pytest.mark.parametrize(("count", "is_few"), [(9, True), (10, False)])
def test_few_observations_are_fewer_than_ten(count, is_few):
    problem = scene()
    drop = np.flatnonzero(problem.observation_image == 1)[count:]
    keep = np.delete(np.arange(problem.num_observations), drop)
    arrays = ("observation_image", "observation_point", "observation_xy", "observation_keypoint")
    problem = problem.replace(**{name: getattr(problem, name)[keep] for name in arrays})
    assert ("images_with_few_observations" in kinds(problem)) == is_few


@pytest.mark.parametrize(
    ("median", "error", "is_gross"),
    [(0.1, 9.9, False), (0.1, 10.1, True), (1.0, 19.9, False), (1.0, 20.1, True)],
)
def test_a_gross_error_exceeds_ten_pixels_and_twenty_medians(median, error, is_gross):
    problem = scene()
    errors = np.full(problem.num_observations, median)
    errors[7] = error
    behind = np.zeros(problem.num_observations, bool)
    depths = depths_of_observations(problem)
    found = suspicions(problem, covisibility(problem), errors, behind, depths)
    assert ("gross_errors" in {one.kind for one in found}) == is_gross


def cross(num_points):
    """Points at a distance of 1 from the origin, which is their median."""
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    return np.resize(axes, (num_points, 3))


@pytest.mark.parametrize(("distance", "is_far"), [(999.0, False), (1001.0, True)])
def test_a_far_point_is_a_thousand_scenes_away(distance, is_far):
    points = cross(30)
    points[4] = [0.0, 0.0, distance]
    assert ("far_points" in kinds(scene(points=points))) == is_far


@pytest.mark.parametrize(("offset", "is_far"), [(0.99e5, False), (1.01e5, True)])
def test_a_far_scene_is_a_hundred_thousand_of_its_sizes_away(offset, is_far):
    points = cross(30)
    points[:, 1] += offset
    assert ("far_from_origin" in kinds(scene(points=points))) == is_far


@pytest.mark.parametrize(("off", "is_wrong"), [(0.5e-6, False), (2e-6, True)])
def test_a_quaternion_is_normalised_to_a_millionth(off, is_wrong):
    poses = scene().cam_from_world.copy()
    poses[1, :4] *= (1 + off) / np.linalg.norm(poses[1, :4])
    assert ("quaternions_not_normalised" in kinds(scene(cam_from_world=poses))) == is_wrong


def test_a_depth_of_zero_is_behind_and_a_tiny_one_collapsed():
    found = summarize(np.array([-1.0, 0.0, 0.9e-4, 1.1e-4, 1.0, 1.0, 1.0, 1.0, 2.0]))
    assert found.median == 1.0
    assert found.num_behind == 2
    assert found.num_collapsed == 2


def test_a_point_far_off_at_a_depth_of_zero_has_not_collapsed():
    problem = scene()
    depths = depths_of_observations(problem)
    depths[5] = 0.0  # as a wide lens sees it, at 90 degrees from its axis
    assert not collapsed_observations(problem, depths).any()


def test_one_collapsed_point_of_a_result_is_no_broken_model():
    problem = bundle.synthesize(scene="orbit", num_images=6, num_points=100, seed=1).ground_truth
    most = problem.num_observations // 100
    seen, first = np.unique(problem.observation_point, return_index=True)
    for count, expected in ((most, []), (most + 1, ["collapsed_points"])):
        points = problem.points.copy()
        points[seen[:count]] = problem.projection_centers[problem.observation_image[first[:count]]]
        found = broken_parts(problem.replace(points=points))
        assert [one.kind for one in found] == expected
