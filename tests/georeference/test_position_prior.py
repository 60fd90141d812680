"""Priors of positions: what they cost by their formula, and what they refuse."""

import copy
import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import InputError
from bundle.georeference.vector_priors import PositionPrior
from tests import scenes

LEVER = np.array([0.2, -0.1, 0.4])


def antenna(pose, lever):
    rotation = Rotation.from_quat(pose[:4])
    return rotation.inv().apply(lever - pose[4:])


@pytest.mark.parametrize(
    ("settings", "covariance"),
    [
        ({"sigma": 2.0}, np.diag([4.0, 4, 4])),
        ({"sigma": (2.0, 5.0)}, np.diag([4.0, 4, 25])),
        ({"sigma": [1.0, 2.0, 3.0]}, np.diag([1.0, 4, 9])),
        ({"covariance": [[4, 1, 0], [1, 3, 0.5], [0, 0.5, 2]]}, None),
    ],
)
def test_cost_by_the_formula(settings, covariance):
    problem = scenes.make_problem(num_images=3, num_points=20)
    if covariance is None:
        covariance = np.array(settings["covariance"])
    position = [0.5, -0.3, 2.0]
    prior = PositionPrior(2, position, lever_arm=LEVER, **settings)
    np.testing.assert_allclose(prior.full_covariance, covariance, rtol=1e-15)
    error = antenna(problem.cam_from_world[1], LEVER) - position
    expected = 0.5 * error @ np.linalg.solve(covariance, error)
    result = bundle.solve(problem, factors=[prior.factor(2)], max_num_iterations=0)
    assert result.factor_costs_before[0] == pytest.approx(expected, rel=1e-12)
    assert 0.5 * prior.whiten(error) @ prior.whiten(error) == pytest.approx(expected, rel=1e-12)


def test_the_scale_of_a_loss_is_in_sigmas():
    problem = scenes.make_problem(num_images=3, num_points=20)
    settings = {"loss": "cauchy", "loss_scale": 1.5}
    prior = PositionPrior(1, [7, 8, 9], 0.5, **settings)
    squared = np.sum((problem.projection_centers[0] - [7, 8, 9]) ** 2) / 0.25
    result = bundle.solve(problem, factors=[prior.factor(1)], max_num_iterations=0)
    expected = 0.5 * 1.5**2 * np.log1p(squared / 1.5**2)
    assert result.factor_costs_before[0] == pytest.approx(expected, rel=1e-12)
    from scipy.stats import chi2

    assert PositionPrior(1, [7, 8, 9], 0.5).loss_scale ** 2 == pytest.approx(chi2.ppf(0.95, 3))


@pytest.mark.parametrize(
    ("position", "settings"),
    [
        ((1.0, 2.0, np.nan), {"sigma": 0.5}),
        ((1.0, 2.0, 3.0), {"sigma": (0.5, np.inf)}),
        ((1.0, 2.0, np.nan), {"covariance": np.diag([0.25, 0.25, 9.0]) + 0.01}),
    ],
)
def test_an_axis_that_is_not_known_counts_for_nothing(position, settings):
    problem = scenes.make_problem(num_images=3, num_points=20)
    prior = PositionPrior(1, position, **settings)
    error = (problem.projection_centers[0] - position)[:2]
    covariance = np.asarray(settings.get("covariance", 0.25 * np.eye(3)))[:2, :2]
    expected = 0.5 * error @ np.linalg.solve(covariance, error)
    result = bundle.solve(problem, factors=[prior.factor(1)], max_num_iterations=0)
    assert result.factor_costs_before[0] == pytest.approx(expected, rel=1e-12)
    nothing = PositionPrior(1, position, np.inf).factor(1)
    result = bundle.solve(problem, factors=[nothing], max_num_iterations=0)
    assert result.factor_costs_before[0] < 1e-100


@pytest.mark.parametrize(
    ("arguments", "settings", "words"),
    [
        ((1.5, [0, 0, 0], 1), {}, "image: expected an id or a name, found 1.5"),
        ((True, [0, 0, 0], 1), {}, "image: expected an id or a name"),
        ((1, [0, 0], 1), {}, r"position: expected 3 numbers, found shape \(2,\)"),
        ((1, [np.nan, 0, 0], 1), {}, "position: expected finite numbers"),
        ((1, [0, 0, np.inf], 1), {}, "position: expected finite numbers"),
        ((1, ["a", 0, 0], 1), {}, "position: expected numbers"),
        ((1, [0, 0, 0]), {}, "expected either sigma or covariance"),
        ((1, [0, 0, 0], 1), {"covariance": np.eye(3)}, "expected either sigma or covariance"),
        ((1, [0, 0, 0], 0), {}, "sigma: expected numbers above 0"),
        ((1, [0, 0, 0], (1, -2)), {}, "sigma: expected numbers above 0"),
        ((1, [0, 0, 0], np.nan), {}, "sigma: expected numbers above 0"),
        ((1, [0, 0, 0], np.ones(4)), {}, "sigma: expected one number"),
        ((1, [0, 0, 0], np.ones((2, 2))), {}, "sigma: expected one number"),
        ((1, [0, 0, 0]), {"covariance": np.eye(2)}, r"covariance: expected shape \(3, 3\)"),
        ((1, [0, 0, 0]), {"covariance": -np.eye(3)}, "positive definite"),
        ((1, [0, 0, 0]), {"covariance": np.ones((3, 3))}, "positive definite"),
        ((1, [0, 0, 0]), {"covariance": np.eye(3) + np.eye(3, k=1)}, "symmetric"),
        ((1, [0, 0, 0], 1), {"lever_arm": [0, 0, np.nan]}, "lever_arm: expected finite numbers"),
        ((1, [0, 0, 0], 1), {"loss": "robust"}, "loss: expected one of trivial"),
        ((1, [0, 0, 0], 1), {"loss_scale": 0}, "loss_scale: expected more than 0"),
    ],
)
def test_wrong_values_are_one_line(arguments, settings, words):
    with pytest.raises(InputError, match=words) as caught:
        PositionPrior(*arguments, **settings)
    assert str(caught.value).startswith("PositionPrior")


def test_a_prior_is_immutable_and_pickles():
    position = np.array([1.0, 2.0, 3.0])
    prior = PositionPrior("a.jpg", position, (1, 2), lever_arm=LEVER)
    position[0] = 9
    assert prior.position.tolist() == [1, 2, 3]
    for again in (pickle.loads(pickle.dumps(prior)), copy.deepcopy(prior)):
        assert again.image == "a.jpg"
        np.testing.assert_array_equal(again.sigma, [1, 1, 2])
        with pytest.raises(ValueError, match="read-only"):
            again.position[0] = 0
    assert "a.jpg" in repr(prior)
