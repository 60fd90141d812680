"""Points and images by what is the matter with them; facts are no problems."""

import dataclasses

import numpy as np
import pytest

import bundle
from bundle.analysis.diagnosis.findings import _rank, scale_drift
from bundle.analysis.diagnosis.track_table import viewing
from tests.analysis.diagnosis import blocks
from tests.analysis.diagnosis.blocks import block


def kinds(found, is_problem):
    return {entry.kind for entry in found.findings if entry.is_problem is is_problem}


@pytest.fixture(scope="module")
def mixed():
    """Points 1 to 5: seen by none, one, two; at a camera; far away along the view."""
    seen = np.ones((8, 60), bool)
    seen[:, 0] = seen[1:, 1] = seen[2:, 2] = False
    problem = block(seed=2, seen=seen, noise=0)
    points = problem.points.copy()
    points[3] = problem.projection_centers[4] + 1e-9
    points[4] = [0.0, 0.0, 1e6]
    return bundle.diagnose(problem.replace(points=points))


def test_points_are_told_apart(mixed):
    assert mixed.unobserved_points.tolist() == [1]
    assert mixed.points_seen_once.tolist() == [2]
    assert mixed.points_seen_twice.tolist() == [3]
    assert mixed.points_at_cameras.tolist() == [4]
    assert mixed.points_at_infinity.tolist() == [5]
    assert len(mixed.points_without_parallax) == 0


def test_only_some_of_that_is_a_problem(mixed):
    assert kinds(mixed, True) == {"points_seen_once", "points_at_cameras", "collapsed_scale"}
    assert kinds(mixed, False) >= {"unobserved_points", "points_seen_twice", "points_at_infinity"}


def test_points_that_are_held_need_no_second_image():
    seen = np.ones((8, 60), bool)
    seen[1:, 1] = False
    found = bundle.diagnose(block(seen=seen), fixed_point_ids=(2,))
    assert len(found.points_seen_once) == 0
    assert "points_seen_once" not in kinds(found, True)


def test_an_image_with_few_observations():
    seen = np.ones((8, 60), bool)
    seen[3, 7:] = False
    found = bundle.diagnose(block(seen=seen))
    assert found.images_with_few_observations.tolist() == [4]
    assert kinds(found, True) == set()


def test_an_image_that_is_held_needs_no_common_points():
    seen = np.ones((8, 72), bool)
    seen[3, 3:60] = False
    seen[:3, 60:] = seen[4:, 60:] = False
    problem = block(seen=seen, num_points=72)
    assert bundle.diagnose(problem).images_with_few_shared_points.tolist() == [4]
    held = bundle.diagnose(problem, fixed_image_ids=(4,))
    assert held.images_with_few_shared_points.tolist() == []


def test_a_solve_that_scales_the_world_is_said():
    problem = block()
    solved = bundle.solve(problem, max_num_iterations=2)
    start = problem.replace(cam_from_world=problem.cam_from_world * [1, 1, 1, 1, 10, 10, 10])
    grown = dataclasses.replace(solved, initial_problem=start)
    assert "scale_drift" in kinds(bundle.diagnose(grown), False)
    drift = scale_drift(grown)
    steps = int(np.count_nonzero(solved.iterations["step_is_successful"][1:]))
    assert drift.num_steps == steps == 2
    assert drift.factor == pytest.approx(0.1, rel=1e-3)
    assert drift.per_step == pytest.approx(10**-0.5, rel=1e-3)
    assert "scale_drift" not in kinds(bundle.diagnose(solved), False)


def test_a_rank_that_depends_on_the_threshold_is_said():
    found = bundle.diagnose(block())
    assert found.rank_gap == found.eigenvalues[0] / found.max_null_eigenvalue > 1e6
    assert "unclear_rank" not in kinds(found, False)
    near = dataclasses.replace(found, max_null_eigenvalue=found.eigenvalues[0] / 999)
    assert near.rank_gap == pytest.approx(999)
    (said,) = _rank(near)
    assert "999 times" in said.sentence and not said.is_problem
    far = dataclasses.replace(found, max_null_eigenvalue=found.eigenvalues[0] / 1001)
    assert not [*_rank(far)]
    assert dataclasses.replace(found, max_null_eigenvalue=0.0).rank_gap == np.inf
    empty = dataclasses.replace(found, eigenvalues=np.zeros(0))
    assert np.isnan(empty.rank_gap) and not [*_rank(empty)]


def test_digits_follow_the_condition_number():
    found = bundle.diagnose(block())
    for condition, normal, root in ((1e6, 10, 13), (1e10, 6, 11), (1e16, 0, 8), (np.nan, 0, 0)):
        other = dataclasses.replace(found, condition_number=condition)
        assert (other.digits_normal_equations, other.digits_square_root) == (normal, root)


@pytest.mark.parametrize(
    ("maker", "cause"),
    [
        (blocks.flat_scene, "flat_scene"),
        (blocks.forward_motion, "forward_motion"),
        (blocks.pure_rotation, "pure_rotation"),
        (blocks.component, ""),
    ],
)
def test_causes(maker, cause):
    problem = maker(1).problem
    assert viewing(problem, np.arange(problem.num_images)).cause == cause
    # A similarity of the world is no cause.
    moved = problem.replace(
        points=7 * problem.points,
        cam_from_world=problem.cam_from_world * [1, 1, 1, 1, 7, 7, 7],
    )
    assert viewing(moved, np.arange(problem.num_images)).cause == cause


def test_images_over_relief_that_never_turn():
    rng = np.random.default_rng(3)
    centers = np.column_stack([rng.uniform(-2, 2, (7, 2)), rng.uniform(-0.3, 0.3, 7)])
    problem = blocks._looking_down(3, centers, 1.2, np.zeros(7))
    (mode,) = bundle.diagnose(problem).weak_modes
    assert (mode.kind, mode.dimension) == ("parallel_views", 1)


def test_a_diagnosis_shows_itself():
    found = bundle.diagnose(blocks.flat_scene(0).problem)
    assert "8 null directions: 7 are gauge, 1 are not determined" in repr(found)
    assert "height" in repr(found) and "height" in found._repr_html_()
