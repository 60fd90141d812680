"""The robust turn of attitude measurements, on turns about the vertical."""

import numpy as np
import pytest

from bundle.georeference.problem_attitudes import agree, exp, log


def agreed(angles, sigma):
    """Return the turn that rotations by these angles about z agree on, and its weights."""
    measured = [exp(np.array([0, 0, angle])) for angle in angles]

    def turns(rotation):
        return log(np.stack([each @ rotation.T for each in measured]))

    found = agree(turns, lambda k: measured[k], np.full((len(angles), 3), sigma), 3)
    return log(found.rotation[None])[0], found.weights


@pytest.mark.parametrize("beyond", [6.0, 12.0, 3.0 / 0.01])
def test_a_measurement_far_beyond_the_noise_has_no_weight(beyond):
    sigma = 0.01
    angles = 0.3 + sigma * np.random.default_rng(0).normal(size=15)
    alone, _ = agreed(angles, sigma)
    turn, weights = agreed([*angles, 0.3 + beyond * sigma], sigma)
    np.testing.assert_allclose(turn, alone, atol=1e-12)
    assert weights[-1] == 0
    assert (weights[:-1] > 0).all()


def test_a_measurement_within_the_noise_counts():
    sigma = 0.01
    angles = np.full(6, 0.3)
    alone, _ = agreed(angles, sigma)
    turn, weights = agreed([*angles, 0.3 + 2 * sigma], sigma)
    assert 0.5 < weights[-1] < 1
    # The mean with Tukey's weight of 2 sigmas, approached from both sides.
    assert alone[2] < turn[2] < alone[2] + 2 * sigma / 7


def test_unequal_sigmas_weigh_each_axis():
    """Differences of 1e-4 sigmas have Tukey's weight 1 to 1e-9: a mean by inverse squares."""
    rng = np.random.default_rng(3)
    sigmas = rng.uniform(0.005, 0.05, (5, 3))
    vectors = 1e-4 * sigmas * rng.normal(size=(5, 3))
    measured = [exp(vector) for vector in vectors]
    found = agree(
        lambda rotation: log(np.stack([each @ rotation.T for each in measured])),
        lambda k: measured[k],
        sigmas,
        3,
    )
    expected = (vectors / sigmas**2).sum(axis=0) / (1 / sigmas**2).sum(axis=0)
    np.testing.assert_allclose(log(found.rotation[None])[0], expected, rtol=1e-4, atol=1e-11)
    lengths = np.linalg.norm((vectors - expected) / sigmas, axis=1)
    np.testing.assert_allclose(found.lengths, lengths, rtol=1e-4)
    np.testing.assert_allclose(found.weights, (1 - (lengths / 4.685) ** 2) ** 2, rtol=1e-12)
