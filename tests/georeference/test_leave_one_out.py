"""Suspects: how often a clean block has one, and gross errors that must be found."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from bundle.georeference.similarity_fit import Correspondences, fit_similarity
from bundle.georeference.survey import LEVEL, Survey, leave_one_out


def survey(rng, count=8, sigma=0.02, stated=0.02, relief=2.0):
    source = np.column_stack([rng.uniform(-30, 30, (count, 2)), relief * rng.normal(size=count)])
    target = source + sigma * rng.normal(size=source.shape)
    return Correspondences(source / 2, target, np.tile(stated**2 * np.eye(3), (count, 1, 1)))


def everything(points):
    every = np.ones(len(points), dtype=bool)
    return leave_one_out(points, every, every)


def test_residuals_are_those_of_a_fit_without_the_point():
    points = survey(np.random.default_rng(0))
    found = everything(points)
    for index in range(len(points)):
        fit = fit_similarity(points.rows(np.arange(len(points)) != index))
        residual = fit.similarity.apply(points.source[index : index + 1])[0] - points.target[index]
        np.testing.assert_allclose(found.residual[index], residual, atol=1e-9)


def test_predicted_sigmas_are_those_of_repeated_surveys():
    rng = np.random.default_rng(1)
    clean = survey(rng, 5, sigma=0.0)
    one = np.arange(5) == 2
    samples = []
    for _ in range(300):
        noisy = clean.target + 0.02 * rng.normal(size=clean.target.shape)
        points = Correspondences(clean.source, noisy, clean.target_covariance)
        found = leave_one_out(points, ~one, one)
        samples.append(found.residual[2])
    np.testing.assert_allclose(np.std(samples, axis=0), found.sigma[2], rtol=0.13)


@pytest.mark.parametrize("stated", [0.02, 0.0005])
def test_clean_blocks_seldom_have_a_suspect(stated):
    """Also where the stated sigmas are forty times too small."""
    rng = np.random.default_rng(2)
    blocks = 50
    wrong = sum(everything(survey(rng, 7, stated=stated)).suspect.any() for _ in range(blocks))
    assert wrong <= stats.binom.ppf(0.999, blocks, LEVEL)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("stated", [0.02, 0.001])
def test_gross_errors_are_found_and_neighbours_left_alone(axis, stated):
    rng = np.random.default_rng(3)
    points = survey(rng, 10, stated=stated)
    points.target[4, axis] += 0.6
    np.testing.assert_array_equal(np.flatnonzero(everything(points).suspect), [4])
    points.target[7, axis] -= 0.25  # hidden by the larger one until that is left out
    np.testing.assert_array_equal(np.flatnonzero(everything(points).suspect), [4, 7])


def test_few_points_say_nothing():
    rng = np.random.default_rng(4)
    found = everything(survey(rng, 3))
    assert np.isnan(found.residual).all() and not found.suspect.any()
    # The fourth is predicted, but the three others lie on one line.
    points = survey(rng, 4)
    points.source[:3] = np.outer([0, 1, 2], [1, 1, 0])
    points.target[:3] = 2 * points.source[:3]
    found = everything(points)
    assert np.isnan(found.residual[3]).all() and np.isfinite(found.residual[:3]).all()


def test_check_points_are_tested_and_test_nobody():
    rng = np.random.default_rng(5)
    points = survey(rng, 9)
    check = np.arange(9) == 8
    points.target[8, 0] += 5.0
    every = np.ones(9, dtype=bool)
    found = leave_one_out(points, ~check, every)
    alone = everything(points.rows(~check))
    np.testing.assert_array_equal(found.residual[:8], alone.residual)
    np.testing.assert_array_equal(np.flatnonzero(found.suspect), [8])


def test_targets_come_before_positions_of_images():
    survey = SimpleNamespace(measured=range(5), used=np.array([True, False, True, True]))
    assert Survey.tested.fget(survey).tolist() == [True, True, True, False, False]
    found = Survey._of_targets(SimpleNamespace(targets=range(4), used=survey.used), np.arange(5), 9)
    assert found.tolist() == [0, 9, 1, 2]
