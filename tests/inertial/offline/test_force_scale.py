"""Scale of the forces: an exact quadratic cost, both bounds, and its errors on flights."""

import math

import numpy as np
import pytest

import bundle
from bundle.inertial.offline import imu_adjustment
from bundle.inertial.offline.path_tests import STEP, ForceScale, LeastCost, few_steps
from tests.campaigns.imu_refine import Scene

POSITIONS = np.array([[0.0, 0, 1], [4, 0, 1], [0, 6, 1], [4, 6, 9]])


def quadratic(slopes, curvatures, offsets=(7.0, 3.0, 1.0), growth=-0.5):
    """Costs of images, motions and priors; positions that grow by `growth` times f - 1."""

    def least(forces):
        x = forces - 1
        costs = (
            c + g * x + h * x**2 / 2 for c, g, h in zip(offsets, slopes, curvatures, strict=True)
        )
        return LeastCost(*costs, (1 + growth * x) * POSITIONS + [5.0 * x, 0, 0])

    return least


def test_the_minimum_of_a_quadratic_cost_and_the_variance_of_its_slope():
    rng = np.random.default_rng(2)
    sigmas = 0.6, 0.2, 1.0  # of images, and of motions, whose noise is overstated; of priors
    along = [size * rng.normal(size=40) for size in (1.0, 2.0, 1.5)]
    curvatures = [one @ one for one in along]
    slopes = np.array(
        [s * rng.normal(size=(4000, 40)) @ one for s, one in zip(sigmas, along, strict=True)]
    ).T
    found = [
        ForceScale.of(quadratic(one, curvatures), sigmas[0] ** 2, sigmas[1] ** 2)
        for one in slopes[:300]
    ]
    ratios = 1 - slopes.sum(axis=1) / sum(curvatures)
    np.testing.assert_allclose([one.ratio for one in found], ratios[:300], rtol=1e-9)
    assert found[0].sigma == pytest.approx(ratios.std(), rel=0.03)
    assert np.ptp([one.sigma for one in found]) < 1e-9


def test_the_movement_is_a_share_of_the_distances_from_the_mean():
    found = ForceScale.of(quadratic((1.0, -4.0, 1.0), (20.0, 25.0, 5.0)), 1.0, 1.0)
    assert found.ratio == pytest.approx(1.04)
    assert found.sigma == pytest.approx(50**-0.5)
    assert found.gain == pytest.approx(2.0**2 / 50)
    assert found.movement == pytest.approx(0.5 * 0.04)


def test_a_cost_without_a_minimum_tells_nothing():
    for least in (
        quadratic((1.0, 1.0, 0.0), (0.0, 0.0, 0.0)),
        quadratic((1.0, 1.0, 0.0), (1.0, -3.0, 1.0)),
        quadratic((math.nan, 1.0, 0.0), (1.0, 3.0, 1.0)),
    ):
        found = ForceScale.of(least, 1.0, 1.0)
        assert (found.ratio, found.sigma, found.is_wrong) == (1.0, math.inf, False)


def test_both_bounds_of_a_wrong_scale():
    for error, sigmas, movement, is_wrong in (
        (0.03, 3.95, 0.021, True), (-0.03, 3.95, 0.021, True), (0.03, 3.85, 0.021, False),
        (0.03, 9.0, 0.019, False), (-0.01, 3.95, 0.021, True),
    ):  # fmt: skip
        assert ForceScale(1 + error, abs(error) / sigmas, movement).is_wrong == is_wrong


def test_steps_are_few():
    options = few_steps(bundle.SolveOptions(loss="cauchy", initial_trust_region_radius=1.0))
    assert (options.max_num_iterations, options.loss) == (10, "cauchy")
    assert (options.initial_trust_region_radius, options.function_tolerance) == (1e4, 1e-6)
    assert STEP == 0.03


def test_errors_of_the_scale_are_within_its_sigma(monkeypatch):
    """In flight 302, points of weak depth end undamped steps far from a minimum."""
    found = []

    def forces_alone(known):
        found.append(known.forces())
        return ()

    monkeypatch.setattr(imu_adjustment, "imu_findings", forces_alone)
    for seed in (302, 303):
        Scene(seed).run(None)
    errors = np.array([(one.ratio - 1) / one.sigma for one in found])
    assert np.abs(errors).max() < 2.0  # 3.6 and 2.4 before
    assert 0.002 < min(one.sigma for one in found) < max(one.sigma for one in found) < 0.008
