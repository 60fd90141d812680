"""Scale of the forces: an exact quadratic cost, both bounds, and flights with a bias along z."""

import math

import numpy as np
import pytest

import bundle
from bundle.inertial.offline.path_tests import STEP, ForceScale, LeastCost, few_steps

POSITIONS = np.array([[0.0, 0, 1], [4, 0, 1], [0, 6, 1], [4, 6, 9]])


def quadratic(slopes, curvatures, offsets=(7.0, 3.0), growth=-0.5):
    """Costs of images and IMU, and positions that grow by `growth` times f - 1."""

    def least(forces):
        x = forces - 1
        costs = (
            c + g * x + h * x**2 / 2 for c, g, h in zip(offsets, slopes, curvatures, strict=True)
        )
        return LeastCost(*costs, (1 + growth * x) * POSITIONS + [5.0 * x, 0, 0])

    return least


def test_the_minimum_of_a_quadratic_cost_and_the_variance_of_its_slope():
    rng = np.random.default_rng(2)
    by_image, by_imu = rng.normal(size=60), 2 * rng.normal(size=40)
    images, imu = 0.6 * rng.normal(size=(4000, 60)), 1.7 * rng.normal(size=(4000, 40))
    curvatures = by_image @ by_image, by_imu @ by_imu
    found = [
        ForceScale.of(quadratic((a @ by_image, b @ by_imu), curvatures), 0.6**2, 1.7**2)
        for a, b in zip(images[:300], imu[:300], strict=True)
    ]
    slopes = images @ by_image + imu @ by_imu
    ratios = 1 - slopes / sum(curvatures)
    np.testing.assert_allclose([one.ratio for one in found], ratios[:300], rtol=1e-9)
    assert found[0].sigma == pytest.approx(ratios.std(), rel=0.03)
    assert np.ptp([one.sigma for one in found]) < 1e-9


def test_the_movement_is_a_share_of_the_distances_from_the_mean():
    found = ForceScale.of(quadratic((1.0, -3.0), (20.0, 30.0)), 1.0, 1.0)
    assert found.ratio == pytest.approx(1.04)
    assert found.sigma == pytest.approx(50**-0.5)
    assert found.movement == pytest.approx(0.5 * 0.04)


def test_a_cost_without_a_minimum_tells_nothing():
    for least in (
        quadratic((1.0, 1.0), (0.0, 0.0)),
        quadratic((1.0, 1.0), (1.0, -3.0)),
        quadratic((math.nan, 1.0), (1.0, 3.0)),
    ):
        found = ForceScale.of(least, 1.0, 1.0)
        assert (found.ratio, found.sigma, found.is_wrong) == (1.0, math.inf, False)


def test_both_bounds_of_a_wrong_scale():
    for error, sigmas, movement, is_wrong in (
        (0.03, 3.95, 0.021, True), (-0.03, 3.95, 0.021, True), (0.03, 3.85, 0.021, False),
        (0.03, 9.0, 0.019, False), (-0.01, 3.95, 0.021, True),
    ):  # fmt: skip
        assert ForceScale(1 + error, abs(error) / sigmas, movement).is_wrong == is_wrong


def test_steps_are_few_and_not_damped():
    options = few_steps(bundle.SolveOptions(loss="cauchy"))
    assert (options.max_num_iterations, options.loss) == (3, "cauchy")
    assert options.initial_trust_region_radius == 1e8
    assert STEP == 0.03
