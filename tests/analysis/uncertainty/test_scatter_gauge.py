"""The sandwich under inner constraints, of a dense and of a sparse reduced system."""

import numpy as np
import pytest

import bundle
from tests.analysis.uncertainty.test_point_passes import OBSERVATIONS, assert_same, scene
from tests.campaigns.covariance import TOLERANCE, compare_seed


@pytest.mark.parametrize("seed", [37, 65])
def test_points_do_not_lose_what_compensating_parameters_hide(seed):
    """Cameras are a thousand times less certain than what points see of them."""
    sandwich = next(entry for entry in compare_seed(seed) if entry.robust == "sandwich")
    assert sandwich.rounding < TOLERANCE * 2
    assert sandwich.difference < TOLERANCE


@pytest.mark.parametrize("num_images", [5, 60])
@pytest.mark.parametrize("gauge", ["inner", "two_cameras"])
def test_residuals_of_unit_covariance_scatter_as_weights_say(num_images, gauge):
    """Each observation twice, with residuals (1, 0) and (0, 1): M is half of H."""
    exact = scene(
        num_images=num_images,
        num_points=10 * num_images,
        track=8 if num_images > 8 else None,
        noise=0,
        perturbation=0,
    )
    count = exact.num_observations
    twice = {name: np.repeat(getattr(exact, name), 2, axis=0) for name in OBSERVATIONS}
    twice["observation_xy"] = twice["observation_xy"] - np.tile(np.eye(2), (count, 1))
    problem = exact.replace(**twice)
    whole = bundle.covariance(problem, gauge=gauge)
    scatter = bundle.covariance(problem, gauge=gauge, robust="sandwich")
    assert_same(scatter, whole, factor=0.5, tolerance=1e-7)
