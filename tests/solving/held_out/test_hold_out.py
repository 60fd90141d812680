"""Choice of held-out observations."""

import numpy as np
import pytest

import bundle
from bundle.model.folds import folds_of
from bundle.solving.hold_out import FEWEST_OF_IMAGE, choose
from tests.model.test_folds import tracks
from tests.scenes import make_problem, with_observations


def photographs():
    """Return 12 images of 400 points in two to twelve images; images differ in observations."""
    rng = np.random.default_rng(2)
    problem = make_problem(num_images=12, num_points=400)
    chance = np.linspace(0.15, 0.9, 12)[problem.observation_image]
    return with_observations(problem, rng.random(problem.num_observations) < chance)


def images_left(problem, held):
    """Return the number of images of each point without the held-out observations."""
    pairs = np.stack([problem.observation_point, problem.observation_image])[:, ~held]
    return np.bincount(np.unique(pairs, axis=1)[0], minlength=problem.num_points)


@pytest.mark.parametrize("percent", [0.5, 10, 30, 45])
def test_each_image_loses_its_share_and_each_point_keeps_two_images(percent):
    problem = photographs()
    held = choose(problem, percent)
    before = np.bincount(problem.observation_image)
    lost = np.bincount(problem.observation_image[held], minlength=12)
    if percent <= 10:
        assert (np.abs(lost - before * percent / 100) <= 0.5).all()
    else:  # few points that three images see limit some images
        assert (lost <= before * percent / 100 + 0.5).all()
        assert lost.sum() > 0.6 * percent / 100 * before.sum()
    touched = np.unique(problem.observation_point[held])
    assert images_left(problem, held)[touched].min() >= 2


def test_an_image_of_few_observations_keeps_six():
    problem = photographs()
    few = np.flatnonzero(problem.observation_image == 3)[7:]
    problem = problem.select(
        observations=np.delete(np.arange(problem.num_observations), few)
    ).problem
    held = choose(problem, 45)
    assert (problem.observation_image[held] == 3).sum() <= 1
    assert FEWEST_OF_IMAGE == 6


def test_chances_do_not_depend_on_the_length_of_the_track():
    problem = photographs()
    length = np.bincount(problem.observation_point)[problem.observation_point]
    shares = np.mean([choose(problem, 10, seed) for seed in range(60)], axis=0)
    short = shares[(length >= 3) & (length <= 5)].mean()
    long = shares[length >= 8].mean()
    assert short == pytest.approx(long, rel=0.1)
    assert not shares[length < 3].any()


def test_public_function_returns_the_rest_and_the_rows():
    problem = photographs()
    kept, held = bundle.hold_out(problem, percent=10, seed=3)
    mask = choose(problem, 10, 3)
    assert held.tolist() == np.flatnonzero(mask).tolist()
    assert (kept.num_images, kept.num_points) == (problem.num_images, problem.num_points)
    np.testing.assert_array_equal(kept.observation_xy, problem.observation_xy[~mask])
    np.testing.assert_array_equal(kept.observation_point, problem.observation_point[~mask])
    assert not np.array_equal(mask, choose(problem, 10, 4))


def test_order_of_rows_has_no_influence():
    problem, rng = photographs(), np.random.default_rng(0)
    rows = rng.permutation(problem.num_observations)
    held = choose(problem, 20)
    np.testing.assert_array_equal(choose(with_observations(problem, rows), 20), held[rows])


def test_repeats_of_a_point_in_an_image_stay_together():
    problem = tracks()
    pairs = np.stack([problem.observation_image, problem.observation_point])
    _, pair = np.unique(pairs, axis=1, return_inverse=True)
    for seed in range(20):
        held = choose(problem, 25, seed)
        of_pair = np.bincount(pair.ravel(), held) / np.bincount(pair.ravel())
        assert set(of_pair.tolist()) <= {0.0, 1.0}
        assert held.any()


def test_images_with_few_observations_keep_them():
    problem = make_problem(num_images=5, num_points=FEWEST_OF_IMAGE + 1)
    held = choose(problem, 50)
    assert np.bincount(problem.observation_image[held], minlength=5).max() == 1
    with pytest.raises(bundle.InputError, match="expected images with more than"):
        choose(make_problem(num_images=5, num_points=FEWEST_OF_IMAGE), 50)


def test_choice_among_some_observations():
    problem = photographs()
    among = problem.observation_image < 3
    held = choose(problem, 10, 0, among)
    assert held[among].any()
    assert not held[~among].any()


@pytest.mark.parametrize("percent", [0, -1, 50.1, float("nan"), "ten"])
def test_percent_out_of_range(percent):
    with pytest.raises(bundle.InputError, match=r"^percent: expected"):
        bundle.hold_out(photographs(), percent)


def test_points_of_two_images_cannot_lose_an_observation():
    problem = make_problem(num_images=6, num_points=60, track=2)
    assert (folds_of(problem) == -1).all()
    with pytest.raises(bundle.InputError, match="at least 3 images"):
        bundle.hold_out(problem)
