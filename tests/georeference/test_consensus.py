"""Correspondences that agree, among others that are anywhere."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bundle.georeference.similarity import _squared_lengths, agreeing, umeyama


def correspondences(count, sigma, seed, flat=False):
    rng = np.random.default_rng(seed)
    source = rng.standard_normal((count, 3)) * [1, 1, 0.01 if flat else 0.5]
    rotation = Rotation.random(random_state=seed).as_matrix()
    target = 40 * source @ rotation.T + [100, -300, 20]
    return source, target + sigma * rng.standard_normal((count, 3)), np.full((count, 3), sigma)


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize(("count", "wrong"), [(5, 1), (8, 2), (18, 7), (40, 17), (3000, 1400)])
def test_nearly_half_may_be_anywhere(count, wrong, flat):
    source, target, sigmas = correspondences(count, 0.1, 7, flat)
    rng = np.random.default_rng(1)
    target[:wrong] += 10.0 ** rng.integers(1, 7, (wrong, 1)) * rng.standard_normal((wrong, 3))
    chosen = agreeing(source, target, sigmas)
    assert not chosen[:wrong].any()
    assert chosen[wrong:].mean() > 0.85
    fit = umeyama(source[chosen], target[chosen])
    assert fit.scale == pytest.approx(40, rel=0.01)


def test_all_agree_where_nothing_is_wrong():
    for seed in range(20):
        source, target, sigmas = correspondences(12, 0.1, seed)
        assert agreeing(source, target, sigmas).sum() >= 10
        # Sigmas that are far too small are no reason to drop anything.
        assert agreeing(source, target, sigmas / 100).sum() >= 8
        assert agreeing(source, target, sigmas * 100).all()


def test_the_noise_of_a_triple_is_taken_out():
    shares = []
    for seed in range(30):
        source, target, sigmas = correspondences(40, 0.1, seed)
        shares.append(agreeing(source, target, sigmas).mean())
    assert np.mean(shares) > 0.93  # 95 % of good points are within the limit


def test_points_within_their_sigmas_all_agree():
    source, target, sigmas = correspondences(300, 0.1, 2)
    assert agreeing(source, target, 3 * sigmas).all()
    assert not agreeing(source, target, sigmas).all()


def test_a_triple_of_exact_points_gives_the_exact_similarity():
    source, target, sigmas = correspondences(10, 0.0, 6)
    triples = np.array([[0, 1, 2], [9, 4, 7]])
    squared = _squared_lengths(source, target, sigmas + 1, triples, np.arange(10))
    assert squared.max() < 1e-18


def test_triples_of_copies_are_passed_over():
    source, target, sigmas = correspondences(12, 0.1, 8)
    source[:5], target[:5] = source[0], target[0]
    target[-3:] += 50
    chosen = agreeing(source, target, sigmas)
    assert chosen[:9].all()
    assert not chosen[9:].any()


def test_coordinates_that_do_not_count():
    source, target, sigmas = correspondences(10, 0.1, 3)
    target[4:, 2] += 50
    sigmas[4:, 2] = 1e100
    assert agreeing(source, target, sigmas).sum() >= 9


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_with_three_there_is_nothing_to_choose(count):
    source, target, sigmas = correspondences(count, 0.1, 1)
    assert agreeing(source, target, sigmas).tolist() == [True] * count


def test_degenerate_points_are_left_to_the_fit():
    for source in (np.zeros((6, 3)), np.outer(np.arange(6.0), [1, 2, 3])):
        chosen = agreeing(source, 2 * source, np.ones((6, 3)))
        assert chosen.all()


def test_equal_input_equal_output():
    source, target, sigmas = correspondences(200, 0.1, 5)
    first = agreeing(source, target, sigmas)
    np.random.seed(3)  # noqa: NPY002 (nobody's global generator has an influence)
    np.testing.assert_array_equal(agreeing(source, target, sigmas), first)
