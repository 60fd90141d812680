"""From where on something looks wrong: each bound from both sides."""

from __future__ import annotations

import numpy as np
import pytest

import bundle
from bundle.analysis.diagnosis.track_table import covisibility
from bundle.analysis.statistics import suspicions as suspicions_module
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


def seen_by_one(kind: str, count: int) -> bundle.Problem:
    """Return a refined model whose image 3 keeps some observations: spread, or close together."""
    made = bundle.synthesize(scene="drone-grid", num_images=8, num_points=600, seed=3)
    problem = bundle.solve(made.problem, num_threads=1).problem
    own = np.flatnonzero(problem.observation_image == 3)
    xy = problem.observation_xy[own]
    near = np.argsort(np.hypot(*(xy - np.median(xy, axis=0)).T))
    spread = np.linspace(0, len(own) - 1, count).astype(int)
    kept = problem.observation_image != 3
    kept[own[near[:count] if kind == "near" else spread]] = True
    return problem.select(observations=kept).problem


@pytest.mark.parametrize(
    ("kind", "count"), [("spread", 3), ("spread", 4), ("near", 5), ("near", 14)]
)
def test_an_open_rotation_is_that_of_the_covariance_with_all_others_known(monkeypatch, kind, count):
    problem = seen_by_one(kind, count)
    others = problem.image_ids[problem.image_ids != problem.image_ids[3]].tolist()
    known = {"refine": ("poses", "points"), "scale": "unit", "gauge": "none"}
    found = bundle.covariance(problem, fixed_image_ids=others, of="poses", **known)
    sigma = float(np.sqrt(np.linalg.eigvalsh(found.pose_covariance[3][:3, :3])[-1]))
    for factor, expected in ((0.999, ["undetermined_poses"]), (1.001, [])):
        monkeypatch.setattr(suspicions_module, "OPEN_ROTATION", factor * sigma)
        named = broken_parts(problem)
        assert [one.kind for one in named] == expected
        assert all(one.evidence["ids"] == [problem.image_ids[3]] for one in named)


def test_two_observations_leave_a_rotation_open_unless_something_else_holds_it():
    problem = seen_by_one("spread", 2)
    (found,) = broken_parts(problem)
    assert found.kind == "undetermined_poses" and found.evidence["count"] == 1
    image = problem.image_ids.tolist()[3]
    assert not broken_parts(problem, {image})
    assert not broken_parts(problem, {problem.image_names[3]})
    assert broken_parts(problem, {image + 1})
    assert not broken_parts(seen_by_one("spread", 8))


def test_many_well_spread_observations_are_not_linearised(monkeypatch):
    monkeypatch.setattr(suspicions_module, "linearize", None)
    assert not broken_parts(seen_by_one("spread", 15))
    with pytest.raises(TypeError):
        broken_parts(seen_by_one("spread", 14))


def test_derivatives_that_overflow_do_not_count():
    problem = seen_by_one("spread", 8)
    params = problem.camera_params.copy()
    params[:, 0] = 1e200
    kinds = {one.kind for one in broken_parts(problem.replace(camera_params=params))}
    assert kinds == {"absurd_focal_lengths", "undetermined_poses"}


def test_observations_close_together_are_linearised_whatever_their_number(monkeypatch):
    problem = seen_by_one("near", 60)
    own = problem.observation_xy[problem.observation_image == 3]
    narrow = np.linalg.eigvalsh(np.cov(own.T, bias=True))[0]
    difference = narrow / problem.camera_params[0, 0] * np.sqrt(60)
    monkeypatch.setattr(suspicions_module, "OPEN_ROTATION", 0.003)  # it has 0.005 rad
    for factor, expected in ((1.001, [problem.image_ids[3]]), (0.999, [])):
        monkeypatch.setattr(suspicions_module, "SMALL_DIFFERENCE", factor * difference)
        found = broken_parts(problem)
        assert [one.evidence["ids"] for one in found] == ([expected] if expected else [])


def test_the_poses_of_rigs_are_not_judged_by_single_images(monkeypatch):
    problem = seen_by_one("spread", 2)
    assert broken_parts(problem)
    frames = np.zeros(problem.num_images, np.int32)
    monkeypatch.setattr(type(problem), "num_frames", 1)
    object.__setattr__(problem, "image_frame", frames)
    assert not broken_parts(problem)
