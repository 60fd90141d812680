"""Statements on attitudes in a model: coverage of the bound, images that do not count."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle import GravityPrior, HeadingPrior, OrientationPrior
from bundle.georeference.attitudes import AttitudeErrors
from bundle.georeference.problem_attitudes import ProblemAttitudes
from bundle.georeference.similarity import moved
from tests.georeference.test_attitude_priors import rotations, upright_and_turned
from tests.rig_scenes import STEREO, rig_problem

AXIS = (1, 0.3, 0.2)
TRIALS = 200


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


@pytest.mark.parametrize("kind", [GravityPrior, OrientationPrior, HeadingPrior])
@pytest.mark.parametrize("count", [1, 3, 5, 8])
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
    assert held > 0.91 * TRIALS  # 95 % less 2.6 standard errors


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


def test_images_of_a_rig_are_tied_by_its_frame():
    problem = rig_problem(rigs=(STEREO,), num_frames=5)
    problem = with_observations(problem, problem.observation_image % 2 == 0)
    priors = measured(problem, GravityPrior, 1.0, np.random.default_rng(1))
    known = ProblemAttitudes.make(problem, priors)
    assert known.groups[0].tied(problem).all()
