"""Points that take over the inner constraints are named."""

import numpy as np
import pytest

import bundle
from bundle.analysis.uncertainty.covariance_by_input import FAR, note_on_inner_constraints
from bundle.base.words import named
from tests.scenes import make_problem

NONE = {"null_points": np.zeros(0, np.int32)}


def with_far(count, distance):
    """A problem whose first points are so many times as far from the cameras as the others."""
    problem = make_problem(num_images=4, num_points=60)
    center = np.median(problem.projection_centers, axis=0)
    usual = np.median(np.linalg.norm(problem.points - center, axis=1))
    points = problem.points.copy()
    points[:count] = center + np.array([0.0, 0.0, distance * usual])
    return problem.replace(points=points)


@pytest.mark.parametrize("count", [1, 5, 6])
def test_ids_are_named_up_to_a_number(count):
    problem = with_far(count, 10 * FAR)
    note = note_on_inner_constraints(problem, NONE)
    ids = problem.point_ids[:count].tolist()
    assert named("point", ids) in note and (" and 1 more" in note) == (count > 5)
    assert ("dominates" in note) == (count == 1)


def test_points_that_are_near_or_known_to_be_null_are_no_finding():
    assert note_on_inner_constraints(with_far(3, 0.9 * FAR), NONE) == ""
    far = with_far(3, 1.1 * FAR)
    assert note_on_inner_constraints(far, NONE)
    assert note_on_inner_constraints(far, {"null_points": np.arange(3, dtype=np.int32)}) == ""


def uncertain(share, num_points=60):
    """The output of a covariance whose first point makes this share of the sigma of all poses."""
    problem = make_problem(num_images=4, num_points=num_points)
    center = np.median(problem.projection_centers, axis=0)
    distances = np.linalg.norm(problem.points - center, axis=1)
    arm = np.median(np.linalg.norm(problem.projection_centers - center, axis=1))
    move = 1 / num_points + distances[0] * arm / (distances**2).sum()
    points = np.tile(1e-4 * np.eye(3) / 3, (num_points, 1, 1))
    points[0] = (2 * distances[0]) ** 2 * np.eye(3) / 3
    poses = np.zeros((4, 6, 6))
    poses[:, 3:, 3:] = (move * 2 * distances[0] / share) ** 2 * np.eye(3) / 3
    return problem, {**NONE, "points": points, "poses": poses}


def test_points_whose_sigma_exceeds_their_distance_are_named_if_they_move_the_poses():
    problem, out = uncertain(0.34)
    assert f"1 point with a sigma above the distance (point {problem.point_ids[0]})" in (
        note_on_inner_constraints(problem, out)
    )
    assert note_on_inner_constraints(*uncertain(0.33)) == ""
    out["points"][0] /= 4.1  # the poses cannot move by a point within its distance
    out["poses"] /= 100
    assert note_on_inner_constraints(problem, out) == ""


@pytest.mark.parametrize(("seed", "is_inflated"), [(0, True), (4, False)])
def test_a_note_on_inner_constraints_tells_whether_other_gauges_are_far_more_certain(
    seed, is_inflated
):
    scene = bundle.synthesize(
        seed=seed, num_images=20, num_points=600, outlier_share=0.02, scene="orbit"
    )
    result = bundle.solve(scene.problem, loss="cauchy")

    def sigma(gauge):
        found = bundle.covariance(result, gauge=gauge, robust="sandwich")
        traces = np.trace(found.pose_covariance[:, 3:, 3:], axis1=1, axis2=2)
        return np.sqrt(np.median(traces)), any("dominate" in note for note in found.notes)

    inner, is_named = sigma("inner")
    held, is_named_with_two_cameras = sigma("two_cameras")
    assert (inner > 100 * held) == is_named == is_inflated
    assert not is_named_with_two_cameras
