"""Statements on attitudes in a model: coverage of the bound, images that do not count."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import GravityPrior, HeadingPrior, OrientationPrior
from bundle.georeference.attitudes import AttitudeErrors, Attitudes, _rounded_up
from bundle.georeference.problem_attitudes import ProblemAttitudes
from bundle.georeference.similarity import Similarity, moved
from tests.georeference.test_attitude_priors import rotations, upright_and_turned
from tests.rig_scenes import STEREO, rig_problem

AXIS = (1, 0.3, 0.2)
TRIALS = 80


def measured(problem, kind, sigma, rng):
    """Priors of all images with noise; the standard deviations are right."""
    turns = rotations(problem)
    noise = Rotation.from_rotvec(np.radians(sigma) * rng.normal(size=(problem.num_images, 3)))
    ids = problem.image_ids.tolist()
    if kind is GravityPrior:
        down = (noise * turns).apply([0, 0, -1])
        return [GravityPrior(i, d, sigma) for i, d in zip(ids, down, strict=True)]
    if kind is OrientationPrior:
        seen = (turns * noise).as_quat()
        return [OrientationPrior(i, q, sigma) for i, q in zip(ids, seen, strict=True)]
    east, north, _ = turns.inv().apply(AXIS).T
    seen = np.degrees(np.arctan2(east, north)) + sigma * rng.normal(size=len(ids))
    return [HeadingPrior(i, h, sigma, axis=AXIS) for i, h in zip(ids, seen, strict=True)]


def with_observations(problem, kept):
    return problem.replace(
        observation_image=problem.observation_image[kept],
        observation_point=problem.observation_point[kept],
        observation_xy=problem.observation_xy[kept],
        observation_keypoint=None,
    )


def error_of(turn, kind):
    """Angle in degrees of a turn of a right model, of what the kind measures."""
    if kind is GravityPrior:
        return np.degrees(np.arccos(np.clip(turn[2, 2], -1, 1)))
    return np.degrees(Rotation.from_matrix(turn).magnitude())


@pytest.mark.parametrize(
    ("kind", "count"),
    [
        *((GravityPrior, 1), (GravityPrior, 4), (GravityPrior, 8)),
        *((OrientationPrior, 1), (OrientationPrior, 3)),
        *((HeadingPrior, 3), (HeadingPrior, 5)),
    ],
)
def test_the_bound_holds_with_its_probability(kind, count):
    """Models that follow their measurements: their error is that of the robust mean."""
    truth, _ = upright_and_turned(num_images=count)
    rng = np.random.default_rng(count)
    held = 0
    for _ in range(TRIALS):
        known = ProblemAttitudes.make(truth, measured(truth, kind, 1.0, rng))
        similarity = known.placement(truth)
        found = AttitudeErrors.of(known.groups[0], moved(truth, similarity))
        held += error_of(similarity.rotation, kind) < found.within
        assert found.off < 0.01
    assert held > 0.89 * TRIALS  # 95 % less 2.5 standard errors


def test_images_without_observations_do_not_count():
    """A solve turns them to their own measurement: they agree with any world."""
    truth, _ = upright_and_turned(num_images=12)
    rng = np.random.default_rng(3)
    priors = measured(truth, GravityPrior, 1.0, rng)
    problem = with_observations(truth, truth.observation_image < 6)
    turned = problem.cam_from_world.copy()
    turned[6:, :4] = Rotation.from_euler("x", 40, degrees=True).as_quat()
    problem = problem.replace(cam_from_world=turned)
    all_priors, of_seen = (ProblemAttitudes.make(problem, given) for given in (priors, priors[:6]))
    for similarity in (all_priors.placement(problem), of_seen.placement(problem)):
        assert np.degrees(np.arccos(similarity.rotation[2, 2])) < 2
    found, seen = (AttitudeErrors.of(one.groups[0], problem) for one in (all_priors, of_seen))
    assert (found.within, found.off, found.ratio) == (seen.within, seen.off, seen.ratio)
    assert found.rms_sigmas == seen.rms_sigmas
    assert [image.used for image in found.images] == [True] * 6 + [False] * 6
    none = with_observations(problem, np.zeros(problem.num_observations, bool))
    assert AttitudeErrors.of(all_priors.groups[0], none).within > 0


def test_a_free_model_is_turned_back_by_images_with_observations():
    """A free solve leaves an image without observations where it was."""
    truth, _ = upright_and_turned(num_images=6)
    priors = measured(truth, GravityPrior, 1.0, np.random.default_rng(5))
    problem = with_observations(truth, truth.observation_image < 5)
    (group,) = ProblemAttitudes.make(problem, priors[:5]).groups
    turn = Similarity(1.0, Rotation.from_euler("x", 30, degrees=True).as_matrix(), np.zeros(3))
    free = moved(problem, turn)
    left = free.cam_from_world.copy()
    left[5] = problem.cam_from_world[5]
    here = AttitudeErrors.of(group, problem)
    there = AttitudeErrors.of(group, problem, free.replace(cam_from_world=left))
    assert there.off == pytest.approx(here.off, abs=1e-9)
    assert there.within == pytest.approx(here.within, abs=1e-9)


def test_images_of_a_rig_are_tied_by_its_frame():
    problem = rig_problem(rigs=(STEREO,), num_frames=5, num_alone=2)
    assert problem.image_frame.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, -1, -1]
    problem = with_observations(problem, problem.observation_image % 2 == 0)
    priors = measured(problem, GravityPrior, 1.0, np.random.default_rng(1))
    known = ProblemAttitudes.make(problem, priors)
    assert known.groups[0].tied(problem).tolist() == [True] * 11 + [False]


def radius_of_three_or_four(residuals, sigma):
    """The bound of the note: Tukey's sandwich of the kept residuals with an F factor, gravity."""
    lengths = np.linalg.norm(residuals, axis=1) / sigma
    scale = max(1, np.median(lengths) / 1.17741)
    u = (lengths / (4.685 * scale)) ** 2
    w = (1 - np.minimum(u, 1)) ** 2
    kept = (lengths <= 3.717 * scale).sum()
    slope = np.where(u < 1, (1 - u) * (1 - 3 * u), 0).sum()
    freedom = 2 * (kept - 1)
    factor = freedom * np.expm1(-2 / freedom * np.log(0.05))
    squares = ((w[:, None] * residuals) ** 2).sum()
    return np.sqrt(squares / 2 / slope**2 * kept / (kept - 1) * factor)


@pytest.mark.parametrize("count", [3, 4])
@pytest.mark.parametrize("wrong", [1.0, 0.02])
def test_three_or_four_directions_tell_their_spread(count, wrong):
    truth, _ = upright_and_turned(num_images=count)
    rng = np.random.default_rng(10 + count)
    priors = [
        GravityPrior(one.image, one.direction, wrong * one.sigma_degrees)
        for one in measured(truth, GravityPrior, 1.0, rng)
    ]
    known = ProblemAttitudes.make(truth, priors)
    model = moved(truth, known.placement(truth))
    (group,) = ProblemAttitudes.make(model, priors).groups
    residuals = np.degrees(group.turns(model))[:, :2]
    found = AttitudeErrors.of(group, model)
    assert found.within == pytest.approx(radius_of_three_or_four(residuals, wrong), rel=2e-3)


def radius_of_many(residuals, sigma):
    """The bound of five directions or more, with Tukey's weights and an F factor."""
    lengths = np.linalg.norm(residuals, axis=1) / sigma
    scale, count = max(1, np.median(lengths) / 1.17741), len(lengths)
    w = (1 - np.minimum((lengths / (4.685 * scale)) ** 2, 1)) ** 2
    freedom = 2 * (w.sum() - 1)
    variance = sigma**2 * (w * lengths**2).sum() / freedom / w.sum() * count / (count - 1)
    return np.sqrt(variance * freedom * np.expm1(-2 / freedom * np.log(0.05)))


@pytest.mark.parametrize("count", [5, 9])
@pytest.mark.parametrize("wrong", [1.0, 0.02])
def test_many_directions_tell_their_spread(count, wrong):
    truth, _ = upright_and_turned(num_images=count)
    priors = measured(truth, GravityPrior, 1.0, np.random.default_rng(count))
    turned = Rotation.from_rotvec([0.9, 0, 0]).apply(np.array(priors[1].direction))
    priors[1] = dataclasses.replace(priors[1], direction=turned)  # has no weight
    priors = [dataclasses.replace(one, sigma_degrees=wrong) for one in priors]
    known = ProblemAttitudes.make(truth, priors)
    model = moved(truth, known.placement(truth))
    (group,) = ProblemAttitudes.make(model, priors).groups
    residuals = np.degrees(group.turns(model))[:, :2]
    found = AttitudeErrors.of(group, model)
    assert found.within == pytest.approx(radius_of_many(residuals, wrong), rel=2e-3)


def test_three_directions_of_which_one_is_wrong_tell_nothing():
    truth, _ = upright_and_turned(num_images=3)
    priors = measured(truth, GravityPrior, 0.1, np.random.default_rng(0))
    turned = Rotation.from_rotvec([0.9, 0, 0]).apply(np.array(priors[1].direction))
    priors[1] = GravityPrior(priors[1].image, turned, 0.1)
    (group,) = ProblemAttitudes.make(truth, priors).groups
    assert AttitudeErrors.of(group, truth).within == 180


def test_the_known_error_of_the_model_adds_to_the_unknown_one():
    truth, _ = upright_and_turned(num_images=8)
    priors = measured(truth, GravityPrior, 1.0, np.random.default_rng(4))
    known = ProblemAttitudes.make(truth, priors)
    model = moved(truth, known.placement(truth))
    right = AttitudeErrors.of(ProblemAttitudes.make(model, priors).groups[0], model)
    assert right.off < 1e-4
    turn = Rotation.from_rotvec(np.radians([3.0, 0, 0])).as_matrix()
    tilted = moved(model, Similarity(1.0, turn, np.zeros(3)))
    found = AttitudeErrors.of(ProblemAttitudes.make(tilted, priors).groups[0], tilted)
    assert found.off == pytest.approx(3, abs=1e-4)
    assert found.within == pytest.approx(right.within + 3, abs=2e-4)


@pytest.mark.parametrize("kind", [GravityPrior, OrientationPrior])
def test_sigmas_that_are_too_small_do_not_hide_errors(kind):
    """Stiff directions bend the model to them: residuals of the bent model are small."""
    held, hidden, seeds = 0, 0, range(8)
    for seed in seeds:
        made = bundle.synthesize(scene="orbit", num_images=10, num_points=150, seed=seed)
        truth, start = made.ground_truth, made.problem
        priors = measured(truth, kind, 1.0, np.random.default_rng(seed))
        change = {"sigma_degrees": 0.02}
        stiff = tuple(dataclasses.replace(one, **change) for one in priors)
        result = bundle.solve(start, priors=stiff, num_threads=1)
        (found,) = Attitudes(stiff).errors(result.problem, free=result.without_attitudes)
        (bent,) = Attitudes(stiff).errors(result.problem)
        turn = (rotations(truth).inv() * rotations(result.problem)).mean().as_matrix()
        held += error_of(turn, kind) <= found.within
        hidden += error_of(turn, kind) > bent.within
        assert found.ratio == pytest.approx(50, rel=0.6)
    assert held == len(seeds) and hidden >= 2


def test_a_wrong_image_is_named_and_not_covered():
    made = bundle.synthesize(scene="orbit", num_images=12, num_points=200, seed=5)
    truth = made.ground_truth
    priors = measured(truth, GravityPrior, 0.5, np.random.default_rng(5))
    turned = Rotation.from_rotvec(np.radians([0, 0, 60])).apply(np.array(priors[0].direction))
    priors[0] = dataclasses.replace(priors[0], direction=turned)
    result = bundle.solve(made.problem, priors=priors, num_threads=1)
    (found,) = Attitudes(tuple(priors)).errors(result.problem, free=result.without_attitudes)
    assert [one.image for one in found.suspects] == [truth.image_names[0]]
    assert f"(without {truth.image_names[0]}, which" in found.sentence
    turns = (rotations(truth).inv() * rotations(result.problem))[1:]
    assert error_of(turns.mean().as_matrix(), GravityPrior) <= found.within < 2 * found.off


def test_the_free_model_is_that_of_a_solve_without_attitudes():
    made = bundle.synthesize(scene="orbit", num_images=8, num_points=100, seed=2)
    priors = measured(made.ground_truth, GravityPrior, 2.0, np.random.default_rng(2))
    stiff = [dataclasses.replace(one, sigma_degrees=0.01) for one in priors]
    exact = {"function_tolerance": 1e-12, "max_num_iterations": 200, "num_threads": 1}
    free = bundle.solve(made.problem, priors=stiff, **exact).without_attitudes
    plain = bundle.solve(made.problem, **exact).problem
    first, second = (rotations(one) for one in (free, plain))
    apart = (first[3] * first[0].inv()) * (second[3] * second[0].inv()).inv()
    assert np.degrees(apart.magnitude()) < 1e-3
    assert bundle.solve(made.problem, num_threads=1).without_attitudes is None


@pytest.mark.parametrize(
    ("value", "text"), [(0.1301, "0.14"), (0.13, "0.13"), (4.0, "4"), (99.1, "100"), (0.0, "0")]
)
def test_a_bound_is_never_rounded_down(value, text):
    assert _rounded_up(value) == text


def test_a_free_model_in_another_world_changes_nothing():
    truth, _ = upright_and_turned(num_images=8)
    priors = measured(truth, GravityPrior, 1.0, np.random.default_rng(3))
    (group,) = ProblemAttitudes.make(truth, priors).groups
    turn = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()
    free = moved(truth, Similarity(1.0, turn, np.zeros(3)))
    alone, beside = AttitudeErrors.of(group, truth), AttitudeErrors.of(group, truth, free)
    assert beside.off == pytest.approx(alone.off, abs=1e-6)
    assert beside.within == pytest.approx(alone.within, abs=1e-6)
