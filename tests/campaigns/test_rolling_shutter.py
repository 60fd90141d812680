"""The predictions of the campaign on rolling shutters, and a few of its scenes."""

import numpy as np
import pytest

import bundle
from bundle.model.residuals import linearize
from tests.campaigns import rolling_shutter as campaign
from tests.rolling import Rows

SMALL = {"num_images": 12, "num_points": 150}


@pytest.mark.parametrize("number", range(3))
def test_predictions_are_those_of_a_dense_pseudo_inverse(number):
    """The gauge is left to the pseudo-inverse of all columns, points too."""
    truth = campaign.make(number, 3, **SMALL).ground_truth
    found, count = linearize(truth), truth.num_images
    jacobian = np.zeros((truth.num_observations, 2, 12 * count + 3 * truth.num_points))
    row = np.arange(truth.num_observations)
    for part, first in (
        (found.d_pose, 12 * truth.observation_image),
        (found.d_twist, 12 * truth.observation_image + 6),
        (found.d_point, 12 * count + 3 * truth.observation_point),
    ):
        for j in range(part.shape[2]):
            jacobian[row, :, first + j] = part[:, :, j] / campaign.NOISE
    jacobian = jacobian.reshape(2 * len(row), -1)
    scale = np.linalg.norm(jacobian, axis=0)
    _, s, vt = np.linalg.svd(jacobian / scale, full_matrices=False)
    assert s[-7] < 1e-10 * s[0] < 1e-4 * s[-8]
    root = (vt[:-7] / s[:-7, None] / scale)[:, : 12 * count]
    moving = campaign.kept_by_similarity(truth) @ campaign.centres_by_poses(truth)
    expected = moving @ (root.T @ root) @ moving.T
    predicted = campaign.predicted(truth)
    np.testing.assert_allclose(predicted, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("number", range(3))
def test_errors_of_many_draws_have_the_predicted_covariance(number):
    """Pixels of one scene, with new noise; 29 degrees of freedom times 6 draws."""
    truth = campaign.make(number, 3, **SMALL).ground_truth
    rows = Rows(truth)
    exact = rows.project(rows.fixed_point()).real
    covariance = campaign.predicted(truth.replace(observation_xy=exact))
    rng = np.random.default_rng(number)
    found = []
    for _ in range(6):
        noise = campaign.NOISE * rng.standard_normal(exact.shape)
        solved = bundle.solve(
            truth.replace(observation_xy=exact + noise), refine=campaign.REFINE, **campaign.EXACT
        )
        errors = campaign.position_errors(solved.problem, truth)
        found.append(campaign.chi_squared(errors, covariance))
    assert 0.7 < np.mean(found) < 1.4


@pytest.mark.parametrize("number", range(3))
def test_scenes_reach_one_minimum_from_each_start(number):
    outcome = campaign.run(number, 1, num_images=16, num_points=250)
    assert outcome.same_cost and not outcome.collapses
    assert 0.5 < outcome.chi2 < 1.8
    assert abs(outcome.tied_z) < 4
