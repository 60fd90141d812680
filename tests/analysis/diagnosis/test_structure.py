"""Pieces, joints, rigs, priors and rules: what the nullity has to be, and who is named."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from tests.analysis.diagnosis.blocks import block
from tests.rig_scenes import rig_problem

POSES_AND_POINTS = ("poses", "points")


def kinds(found):
    return {entry.kind for entry in found.findings if entry.is_problem}


@pytest.mark.parametrize(("shared", "more"), [(1, 4), (2, 1), (3, 0)])
def test_a_hinge_of_few_points(shared, more):
    """Two parts that determine themselves: a similarity of one, less three per common point."""
    seen = np.zeros((8, 60), bool)
    seen[:3, :30] = seen[3:, 30:] = seen[:, :shared] = True
    found = bundle.diagnose(block(seen=seen), refine=POSES_AND_POINTS)
    assert (found.nullity, found.expected_nullity) == (7 + more, 7)
    assert found.ok == (more == 0)
    if more:
        (mode,) = found.weak_modes
        assert (mode.kind, mode.dimension, mode.image_ids) == ("few_shared_points", more, (1, 2, 3))


@pytest.mark.parametrize("shared", [2, 3, 4, 5, 8])
def test_two_images_need_five_points(shared):
    found = bundle.diagnose(block(num_images=2, num_points=shared), refine=POSES_AND_POINTS)
    assert found.nullity == 7 + max(5 - shared, 0)
    assert ("few_shared_points" in kinds(found)) == (shared < 5)
    assert found.images_with_few_shared_points.tolist() == ([1, 2] if shared < 5 else [])


def test_pairs_of_images_without_a_third_have_no_common_scale():
    seen = np.zeros((8, 60), bool)
    seen[:7, :30] = seen[6:, 30:] = True  # the last image shares points with the seventh alone
    found = bundle.diagnose(block(seen=seen), refine=POSES_AND_POINTS)
    assert found.nullity == 8
    (mode,) = found.weak_modes
    assert (mode.kind, mode.image_ids) == ("scale_joint", (8,))


def test_an_image_alone():
    seen = np.ones((8, 60), bool)
    seen[7, :50] = seen[:7, 50:] = False
    found = bundle.diagnose(block(seen=seen))
    assert found.nullity == 13
    assert [component.image_ids for component in found.components] == [tuple(range(1, 8)), (8,)]
    assert found.points_seen_once.tolist() == list(range(51, 61))
    assert len(found.points_without_parallax) == 0
    assert {"component", "points_seen_once", "unobserved_pose"} <= kinds(found)


def test_many_components_are_counted():
    rng = np.random.default_rng(0)
    seen = np.repeat(np.eye(20, dtype=bool), 3, axis=0).repeat(20, axis=1)
    turns = rng.uniform(-0.5, 0.5, (60, 3))
    rotations = Rotation.from_rotvec(turns)
    centers = -rotations.inv().apply(np.tile([0, 0, 4.0], (60, 1)))
    problem = block(
        points=rng.uniform(-1, 1, (400, 3)), centers=centers, rotations=rotations, seen=seen
    )
    found = bundle.diagnose(problem)
    assert found.nullity == 140
    assert len(found.components) == 20
    assert sum(entry.kind == "component" for entry in found.findings) == 6


@pytest.mark.parametrize(("refined", "degrees"), [(False, 6), (True, 7)])
def test_rigs_give_the_scale_unless_they_are_refined(refined, degrees):
    problem = rig_problem(perturbation=0, num_alone=2)
    found = bundle.diagnose(problem, refine_sensor_from_rig=refined)
    assert (found.nullity, found.expected_nullity) == (degrees, degrees)
    assert found.ok


def test_frames_that_hang_on_few_points_are_named_by_their_images():
    problem = rig_problem(perturbation=0, num_frames=4)
    last = problem.image_frame[problem.observation_image] == 3
    keep = ~last | (problem.observation_point < 2)
    found = bundle.diagnose(
        problem.replace(
            observation_image=problem.observation_image[keep],
            observation_point=problem.observation_point[keep],
            observation_xy=problem.observation_xy[keep],
            observation_keypoint=problem.observation_keypoint[keep],
        ),
        refine=POSES_AND_POINTS,
    )
    # Both images of the frame see both points: a stereo pair has the distances, not the turn about
    # the line through the points.
    assert (found.nullity, found.expected_nullity) == (7, 6)
    (mode,) = found.weak_modes
    assert set(mode.image_ids) == set(problem.image_ids[problem.image_frame == 3].tolist())


@pytest.mark.parametrize(("count", "degrees"), [(1, 4), (2, 1), (3, 0)])
def test_positions_take_the_gauge(count, degrees):
    problem = block()
    priors = [
        bundle.PositionPrior(f"image{i}.jpg", problem.projection_centers[i], (0.1, 0.1))
        for i in range(count)
    ]
    found = bundle.diagnose(problem, priors=priors)
    assert (found.nullity, found.expected_nullity) == (degrees, degrees)
    assert found.ok


@pytest.mark.parametrize(
    ("rule", "degrees"),
    [
        ("image 1: position fixed", 4),
        ("image 1: rotation fixed", 4),
        ("image 1: rotation,position fixed", 1),
    ],
)
def test_rules_take_the_gauge(rule, degrees):
    found = bundle.diagnose(block(), constraints=[rule])
    assert (found.nullity, found.expected_nullity) == (degrees, degrees)


def test_a_far_origin_costs_no_rank():
    near = block()
    offset = np.array([1e6, -2e6, 3e5])
    poses = near.cam_from_world.copy()
    poses[:, 4:] -= Rotation.from_quat(poses[:, :4]).apply(offset)
    far = near.replace(points=near.points + offset, cam_from_world=poses)
    found = bundle.diagnose(far)
    assert (found.nullity, found.expected_nullity, found.ok) == (7, 7, True)
    assert found.max_null_eigenvalue < 1e-11


def test_a_result_has_its_scale_change():
    problem = block()
    solved = bundle.solve(problem, gauge="none")
    found = bundle.diagnose(solved)
    assert (found.nullity, found.ok) == (7, True)
    assert "scale_drift" not in {entry.kind for entry in found.findings}


@pytest.mark.parametrize("num_points", [3, 4, 5])
@pytest.mark.parametrize("at_one_place", [False, True])
def test_a_pair_with_too_few_points_is_no_panorama(num_points, at_one_place):
    """4n equations for 3n points, 5 of the pair and a focal length: 6 points are needed."""
    problem = block(num_images=2, num_points=num_points)
    if at_one_place:
        poses = problem.cam_from_world.copy()
        turns = Rotation.from_quat(poses[:, :4])
        poses[:, 4:] = turns.apply(-problem.projection_centers[:1].repeat(2, axis=0))
        problem = problem.replace(cam_from_world=poses)
    found = bundle.diagnose(problem, refine=(*POSES_AND_POINTS, "focal"))
    named = {mode.kind for mode in found.weak_modes}
    assert "underdetermined" in named and "pure_rotation" not in named and not found.ok
    assert [mode.kind for mode in found.weak_modes].count("underdetermined") == 1


def test_a_prior_on_an_image_without_observations():
    problem = block()
    unseen = problem.select(observations=problem.observation_image != 7).problem
    prior = bundle.PriorFactor(("image", 8), unseen.cam_from_world[7], sigma=1.0)
    found = bundle.diagnose(unseen, factors=[prior])
    assert found.nullity == found.expected_nullity


def test_a_pair_at_one_place_is_a_panorama():
    problem = block(num_images=2, num_points=12)
    poses = problem.cam_from_world.copy()
    turns = Rotation.from_quat(poses[:, :4])
    poses[:, 4:] = turns.apply(-problem.projection_centers[:1].repeat(2, axis=0))
    found = bundle.diagnose(problem.replace(cam_from_world=poses), refine=POSES_AND_POINTS)
    assert [mode.kind for mode in found.weak_modes] == ["pure_rotation"]


@pytest.mark.parametrize(("share", "named"), [(0.0, True), (1e-6, True), (1.0, False)])
def test_a_rig_without_a_baseline_gives_no_scale(share, named):
    problem = rig_problem()
    arms = problem.sensor_from_rig.copy()
    arms[:, 4:] *= share
    found = bundle.diagnose(problem.replace(sensor_from_rig=arms))
    assert ("rig_without_baseline" in kinds(found)) == named
    assert found.ok == (not named)
