"""Where a problem goes before a solve with priors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError, PositionPrior
from bundle.georeference.prior_alignment import ProblemPriors, _similarity
from bundle.georeference.similarity import Similarity, moved, umeyama
from bundle.georeference.target_priors import TargetPriors
from tests import scenes
from tests.georeference.flights import flight

PLACE = Similarity(
    25.0, Rotation.from_rotvec([0.4, -2.0, 1.1]).as_matrix(), np.array([300.0, -150, 40])
)
LEVER = np.array([0.5, -0.3, 1.2])


def problem_and_goal(num_images=8, noise=0.5, **settings):
    """A problem in a frame of its own, and in the world."""
    problem = scenes.make_problem(
        num_images=num_images, num_points=30, shared=True, noise=0, perturbation=0, **settings
    )
    # The arc of the scene is nearly straight: images of different heights are on no line.
    poses = problem.cam_from_world.copy()
    poses[:, 5] += 0.8 * np.cos(3.0 * np.arange(num_images))
    problem = problem.replace(cam_from_world=poses)
    pixels = problem.observation_xy + scenes.residuals(problem)
    pixels += noise * np.random.default_rng(4).standard_normal(pixels.shape)
    problem = problem.replace(observation_xy=pixels)
    return problem, moved(problem, PLACE)


def antennas(problem, lever=(0, 0, 0)):
    rotation = Rotation.from_quat(problem.cam_from_world[:, :4])
    return rotation.inv().apply(np.asarray(lever) - problem.cam_from_world[:, 4:])


def priors(positions, sigma=0.1, **settings):
    return [
        PositionPrior(i + 1, position, sigma, **settings) for i, position in enumerate(positions)
    ]


def assert_placed(found, goal, atol=1e-6):
    np.testing.assert_allclose(found.projection_centers, goal.projection_centers, atol=atol)
    np.testing.assert_allclose(found.points, goal.points, atol=atol)


def test_exact_positions_give_the_exact_place():
    problem, goal = problem_and_goal()
    known = ProblemPriors.make(problem, priors(goal.projection_centers))
    found, similarity = known.aligned(problem)
    assert_placed(found, goal)
    assert similarity.scale == pytest.approx(25)
    np.testing.assert_allclose(known.residuals(goal), 0, atol=1e-9)
    before, _ = bundle.reprojection_errors(problem)
    np.testing.assert_allclose(bundle.reprojection_errors(found)[0], before, atol=1e-8)


def test_the_antenna_is_not_the_camera():
    problem, goal = problem_and_goal()
    known = ProblemPriors.make(problem, priors(antennas(goal, LEVER), lever_arm=LEVER))
    assert_placed(known.aligned(problem)[0], goal)
    np.testing.assert_allclose(known.residuals(goal), 0, atol=1e-9)
    ignored = ProblemPriors.make(problem, priors(antennas(goal, LEVER)))
    assert np.abs(ignored.aligned(problem)[0].points - goal.points).max() > 0.1


@pytest.mark.parametrize("distance", [30.0, 1e4, 1e7])
def test_wrong_positions_have_no_influence(distance):
    problem, goal = problem_and_goal()
    positions = goal.projection_centers.copy()
    positions[2, 0] += distance
    positions[5] = -distance
    found, _ = ProblemPriors.make(problem, priors(positions)).aligned(problem)
    assert_placed(found, goal)


def test_weights_are_those_of_the_sigmas():
    problem, goal = problem_and_goal()
    noise = 0.5 * np.random.default_rng(2).standard_normal((8, 3))
    exact = np.isin(np.arange(8), [0, 3, 5, 7])
    noise[exact] = 0
    made = [
        PositionPrior(i + 1, goal.projection_centers[i] + noise[i], 1e-3 if exact[i] else 5.0)
        for i in range(8)
    ]
    assert_placed(ProblemPriors.make(problem, made).aligned(problem)[0], goal, atol=1e-4)


@pytest.mark.parametrize("known", [8, 4, 2, 0])
def test_heights_that_are_not_known(known):
    problem, goal = problem_and_goal()
    level = goal.projection_centers.copy()
    if known < 3:  # the cameras are taken to be at one height
        level[:, 2] = level[0, 2]
    positions = level.copy()
    positions[known:, 2] = np.nan
    found, _ = ProblemPriors.make(problem, priors(positions)).aligned(problem)
    if known >= 3:
        assert_placed(found, goal, atol=1e-5)
        return
    # Without heights only the horizontal position is met, about as well as level cameras allow.
    offsets = found.projection_centers[:, :2] - level[:, :2]
    spread = np.ptp(level[:, :2], axis=0).max()
    assert np.abs(offsets).max() < 0.7 * spread


def test_a_vertical_sigma_that_is_infinite_is_an_unknown_height():
    problem, goal = problem_and_goal()
    positions = goal.projection_centers.copy()
    positions[4:, 2] += 30
    made = [
        PositionPrior(i + 1, position, (0.1, np.inf if i >= 4 else 0.1))
        for i, position in enumerate(positions)
    ]
    assert_placed(ProblemPriors.make(problem, made).aligned(problem)[0], goal, atol=1e-5)


def test_a_position_that_is_somewhat_off_has_less_weight():
    problem, goal = problem_and_goal()
    positions = goal.projection_centers.copy()
    positions[0, 2] += 0.5
    found, _ = ProblemPriors.make(problem, priors(positions)).aligned(problem)
    off = np.abs(found.projection_centers - goal.projection_centers).max()
    fit = umeyama(problem.projection_centers, positions)
    equal = np.abs(fit.apply(problem.projection_centers) - goal.projection_centers).max()
    assert off < 0.5 * equal


def test_a_straight_flight():
    problem, goal = problem_and_goal()
    poses = goal.cam_from_world.copy()
    rotations = Rotation.from_quat(poses[:, :4])
    line = np.outer(np.arange(8.0), [30, 40, 0])
    poses[:, 4:] = -rotations.apply(line)
    noise = np.random.default_rng(3).standard_normal((8, 3))
    made = priors(line + noise, 1.0)
    with pytest.raises(InputError, match="line"):
        ProblemPriors.make(problem, made).align(problem.replace(cam_from_world=poses))


@pytest.mark.parametrize(
    ("rows", "words"),
    [([], "at least 3 images"), ([0, 4], "at least 3 images .* found 2")],
)
def test_too_few_positions(rows, words):
    problem, goal = problem_and_goal()
    made = [PositionPrior(i + 1, goal.projection_centers[i], 0.1) for i in rows]
    with pytest.raises(InputError, match=words):
        ProblemPriors.make(problem, made).align(problem)


def test_positions_on_a_line():
    problem, _ = problem_and_goal()
    line = np.outer(np.arange(8.0), [3, 4, 0])
    with pytest.raises(InputError, match="line"):
        ProblemPriors.make(problem, priors(line)).align(problem)
    with pytest.raises(InputError, match="line"):
        ProblemPriors.make(problem, priors(np.ones((8, 3)))).align(problem)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ([PositionPrior(99, [0, 0, 0], 1)], r"priors: \[0\]: image: expected exactly one image 99"),
        ([PositionPrior("no.jpg", [0, 0, 0], 1)], "image 'no.jpg' in the problem, found 0"),
        ([PositionPrior("image1.jpeg", [0, 0, 0], 1)], "did you mean image1.jpg"),
        ([PositionPrior("same.jpg", [0, 0, 0], 1)], "found several"),
        (
            priors(np.zeros((2, 3))) + priors(np.zeros((1, 3))),
            r"\[2\].* another prior of 1 .*\[0\]",
        ),
        (
            [PositionPrior(2, [0, 0, 0], 1), PositionPrior("image1.jpg", [0, 0, 0], 1)],
            "expected one prior per image",
        ),
        ([1, 2], r"expected PositionPriors, found 1 at \[0\]"),
        (PositionPrior(1, [0, 0, 0], 1), "expected a list of PositionPriors"),
        (5, "expected a list of PositionPriors"),
    ],
)
def test_priors_that_name_no_image(made, words):
    problem, _ = problem_and_goal()
    names = (*problem.image_names[:6], "same.jpg", "same.jpg")
    with pytest.raises(InputError, match=words):
        ProblemPriors.make(problem.replace(image_names=names), made)


def test_heights_that_do_not_count_are_unknown():
    problem, goal = problem_and_goal()
    made = [
        PositionPrior(name, [*place[:2], 1e4 * row], sigma=(1.0, np.inf if row % 2 else 1.0))
        for row, (name, place) in enumerate(
            zip(problem.image_names, goal.projection_centers, strict=True)
        )
    ]
    target = ProblemPriors.make(problem, made).correspondences(problem).target
    assert np.isnan(target[:, 2]).tolist() == [bool(row % 2) for row in range(len(made))]


@pytest.mark.parametrize("has_heights", [True, False])
def test_two_control_points_place_a_model_beside_positions_with_an_offset(has_heights):
    made = flight([(-20, -22, 0.5), (21, 20, -0.4)], num_images=9, num_points=60, noise=0.0,
                  target_noise=0.0, survey_noise=0.0)  # fmt: skip
    there, offset = made.elsewhere(), np.array([3.0, -2.0, 45.0])
    positions = made.problem.projection_centers + offset
    gcps = made.gcps
    if not has_heights:
        gcps = [replace(one, position=(*one.position[:2], np.nan)) for one in gcps]
    known = ProblemPriors.make(there, priors(positions, offset="all"))
    found = moved(there, _similarity(there, known, TargetPriors.make(there, gcps)))
    expected = made.problem.projection_centers + (0 if has_heights else offset * [0, 0, 1])
    np.testing.assert_allclose(found.projection_centers, expected, atol=1e-3)
