"""Normalised errors of held-out observations, against dense linear algebra and Monte Carlo."""

import numpy as np
import pytest

from bundle.judging.validation.candidate_fits import (
    normalized_errors,
    prediction_covariances,
    squared_errors,
)
from bundle.model.folds import folds_of
from bundle.model.residuals import linearize
from tests.scenes import make_problem, with_observations


def scene(**changes):
    rng = np.random.default_rng(3)
    problem = make_problem(num_images=6, num_points=30, noise=0, perturbation=0, **changes)
    return with_observations(problem, rng.random(problem.num_observations) < 0.8)


@pytest.mark.parametrize("sigmas", [False, True])
def test_covariances_equal_dense_algebra(sigmas):
    problem = scene()
    scale = np.ones(problem.num_observations)
    if sigmas:
        scale = np.random.default_rng(0).uniform(0.5, 2, problem.num_observations)
        problem = problem.replace(observation_sigma=scale)
    folds = folds_of(problem, 3)
    found = prediction_covariances(problem, folds)
    jacobians = linearize(problem).d_point / scale[:, None, None]
    for row in range(problem.num_observations):
        if folds[row] < 0:
            assert np.isnan(found[row]).all()
            continue
        same = problem.observation_point == problem.observation_point[row]
        left = np.concatenate(jacobians[same & (folds != folds[row])])
        expected = np.eye(2) + jacobians[row] @ np.linalg.inv(left.T @ left) @ jacobians[row].T
        np.testing.assert_allclose(found[row], expected, rtol=1e-8)


def test_predictions_of_noisy_points_have_this_covariance():
    """Triangulate points from noisy pixels, and predict the pixels that were held out."""
    problem, rng = scene(), np.random.default_rng(7)
    folds = folds_of(problem, 3)
    covariances = prediction_covariances(problem, folds)
    jacobians = linearize(problem).d_point
    point, draws = problem.observation_point, []
    for _ in range(400):
        noise = 0.01 * rng.standard_normal((problem.num_observations, 2))
        residuals = np.full((problem.num_observations, 2), np.nan)
        for row in np.flatnonzero(folds >= 0):
            left = (point == point[row]) & (folds != folds[row])
            step = np.linalg.lstsq(np.concatenate(jacobians[left]), noise[left].ravel(), rcond=None)
            residuals[row] = jacobians[row] @ step[0] - noise[row]
        draws.append(squared_errors(residuals, covariances))
    held = np.array(draws)[:, folds >= 0] / 0.01**2
    assert held.mean() == pytest.approx(2.0, rel=0.03)  # chi-square of two degrees of freedom
    assert np.median(held) == pytest.approx(2 * np.log(2), rel=0.03)
    assert np.abs(held.mean(axis=0) - 2).max() < 0.7  # of each observation


def test_squares_are_those_of_the_inverse_covariance():
    residuals = np.array([[3.0, 1.0], [3.0, -1.0], [0.5, 2.0]])
    covariances = np.array([[[2.0, 0.9], [0.9, 1.5]]] * 2 + [[[1.0, -0.8], [-0.8, 4.0]]])
    expected = [r @ np.linalg.solve(s, r) for r, s in zip(residuals, covariances, strict=True)]
    np.testing.assert_allclose(squared_errors(residuals, covariances), expected, rtol=1e-13)


def test_sigma_is_that_of_the_best_candidate_and_missing_errors_stay():
    rng = np.random.default_rng(0)
    covariances = np.tile(np.array([[2.0, 0.3], [0.3, 1.5]]), (4000, 1, 1))
    draws = 0.7 * rng.standard_normal((4000, 2)) @ np.linalg.cholesky(covariances[0]).T
    residuals = np.stack([3 * draws, draws, np.full_like(draws, np.nan)])
    residuals[1, :50] = np.nan
    normalized, sigma = normalized_errors(residuals, covariances)
    assert sigma == pytest.approx(0.7, rel=0.03)
    assert np.isnan(normalized[1, :50]).all()
    assert np.isnan(normalized[2]).all()
    np.testing.assert_allclose(normalized[0, 50:], 3 * normalized[1, 50:])
    assert np.sqrt(np.mean(normalized[1, 50:] ** 2)) == pytest.approx(np.sqrt(2), rel=0.03)


def test_points_without_parallax_and_exact_data():
    """Two rays of one direction do not determine a point: its predictions weigh nothing."""
    problem = scene()
    same = problem.cam_from_world.copy()
    same[:] = same[0]
    folds = folds_of(problem, 3)
    found = prediction_covariances(problem.replace(cam_from_world=same), folds)[folds >= 0]
    assert np.isfinite(found).all()
    exact, sigma = normalized_errors(np.zeros((2, 5, 2)), np.tile(np.eye(2), (5, 1, 1)))
    assert sigma == 0
    assert (exact == 0).all()
