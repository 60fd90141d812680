"""Measured attitudes of synthetic scenes: their noise, and the way back through a solve."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import GravityPrior, OrientationPrior

SMALL = {"scene": "orbit", "num_images": 12, "num_points": 120}


def rotations(problem):
    return Rotation.from_quat(problem.cam_from_world[:, :4])


def test_noise_has_the_given_standard_deviation():
    scene = bundle.synthesize(
        num_images=400, num_points=3000, gravity_sigma=2.0, orientation_sigma=3.0, seed=1
    )
    gravity = [prior for prior in scene.priors if isinstance(prior, GravityPrior)]
    orientations = [prior for prior in scene.priors if isinstance(prior, OrientationPrior)]
    assert len(gravity) == len(orientations) == 400
    true = rotations(scene.ground_truth)
    measured = np.array([prior.direction for prior in gravity])
    across = np.degrees(true.inv().apply(measured)[:, :2])  # along east and north
    np.testing.assert_allclose(across.std(axis=0), 2.0, rtol=0.12)
    turned = Rotation.from_quat([prior.rotation for prior in orientations]).inv() * true
    np.testing.assert_allclose(np.degrees(turned.as_rotvec()).std(axis=0), 3.0, rtol=0.12)
    assert {prior.sigma_degrees for prior in gravity} == {2.0}


def test_measurements_do_not_change_the_scene_and_repeat():
    plain, measured = (bundle.synthesize(**SMALL, gravity_sigma=sigma) for sigma in (0.0, 1.0))
    assert plain.priors == ()
    np.testing.assert_array_equal(measured.problem.observation_xy, plain.problem.observation_xy)
    np.testing.assert_array_equal(
        measured.priors[3].direction,
        bundle.synthesize(**SMALL, gravity_sigma=1.0).priors[3].direction,
    )


@pytest.mark.parametrize(
    "settings",
    [{}, {"rolling_shutter": 0.3}]
    + [{"scene": scene} for scene in ("street", "drone_grid", "photo_collection")],
)
def test_every_scene_has_z_up(settings):
    scene = bundle.synthesize(**{**SMALL, "num_points": 400, **settings}, gravity_sigma=1e-6)
    found = bundle.solve(scene.ground_truth, priors=scene.priors, max_num_iterations=0)
    assert found.similarity is None or np.allclose(found.similarity.rotation, np.eye(3), atol=1e-6)


def test_models_become_upright_within_the_sigma():
    tilts, sigma = [], 1.0
    for seed in range(20):
        scene = bundle.synthesize(**SMALL, gravity_sigma=sigma, seed=seed)
        found = bundle.solve(scene.problem, priors=scene.priors).problem
        # The solve leaves heading, position and scale; the turn to the truth is nearly rigid.
        turn = (rotations(scene.ground_truth).inv() * rotations(found)).mean()
        east, north, up = turn.as_matrix()[:, 2]
        tilts += [np.degrees(east), np.degrees(north)]
        assert up > 0.99
    expected = sigma / np.sqrt(SMALL["num_images"])
    z = np.array(tilts) / expected
    assert np.sqrt((z**2).mean()) == pytest.approx(1, abs=0.3)  # 40 numbers: 0.11
    assert abs(z.mean()) < 0.5


def test_a_tenth_of_gross_outliers_needs_a_robust_loss():
    tilts = {"trivial": [], "cauchy": [], "tukey": []}
    for seed in range(5):
        scene = bundle.synthesize(**{**SMALL, "num_images": 20}, gravity_sigma=1.0, seed=seed)
        rng = np.random.default_rng(seed)
        for loss, errors in tilts.items():
            priors = [
                GravityPrior(
                    prior.image,
                    rng.normal(size=3) if k % 10 == 3 else prior.direction,
                    1.0,
                    loss=loss,
                )
                for k, prior in enumerate(scene.priors)
            ]
            found = bundle.solve(scene.problem, priors=priors).problem
            turn = (rotations(scene.ground_truth).inv() * rotations(found)).mean()
            errors.append(np.degrees(np.arccos(min(1.0, turn.as_matrix()[2, 2]))))
    assert max(tilts["cauchy"]) < 1.0 and max(tilts["tukey"]) < 1.0
    assert np.mean(tilts["trivial"]) > 2


def test_a_direction_counts_as_two_measurements():
    scene = bundle.synthesize(**SMALL, gravity_sigma=1.0, seed=3)
    solved = bundle.solve(scene.problem, priors=scene.priors).problem
    alone = bundle.covariance(solved, gauge="inner").dof
    held = bundle.covariance(solved, gauge="inner", priors=scene.priors).dof
    assert held - alone == 2 * len(scene.priors) - 2  # gravity takes two directions of the gauge
