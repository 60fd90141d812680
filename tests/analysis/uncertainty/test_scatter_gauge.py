"""The sandwich under inner constraints, of a dense and of a sparse reduced system."""

import numpy as np
import pytest
from scipy.linalg import solve_triangular

import bundle
from tests.analysis.uncertainty.test_null_points_gauge import similarities
from tests.analysis.uncertainty.test_point_passes import OBSERVATIONS, assert_same, scene
from tests.campaigns.covariance import TOLERANCE, compare_seed


@pytest.mark.parametrize("seed", [37, 65])
def test_points_do_not_lose_what_compensating_parameters_hide(seed):
    """Cameras are a thousand times less certain than what points see of them."""
    sandwich = next(entry for entry in compare_seed(seed) if entry.robust == "sandwich")
    assert sandwich.rounding < TOLERANCE * 3
    assert sandwich.difference < TOLERANCE


def leverages(problem):
    """J_i (J^T J)^+ J_i^T of every observation, with the focal lengths and k refined."""
    linear = bundle.model.residuals.linearize(problem)
    parts = (
        (linear.d_pose, problem.observation_image),
        (linear.d_params[..., [0, 3]], problem.image_camera[problem.observation_image]),
        (linear.d_point, problem.observation_point),
    )
    jacobian = np.zeros((problem.num_observations, 2, 0))
    for values, index in parts:
        one = np.zeros((len(index), 2, index.max() + 1, values.shape[2]))
        one[np.arange(len(index)), :, index] = values
        jacobian = np.concatenate([jacobian, one.reshape(len(index), 2, -1)], axis=2)
    world = similarities(problem)
    null = np.zeros((jacobian.shape[2], 7))
    null[: 6 * problem.num_images] = world[: 6 * problem.num_images]
    null[-3 * problem.num_points :] = world[6 * problem.num_images :]
    rows = jacobian.reshape(len(jacobian) * 2, -1)
    norms = np.linalg.norm(rows, axis=0)
    used = norms > 0
    rows = rows[:, used] / norms[used]
    held, _ = np.linalg.qr(null[used] * norms[used, None])
    lower = np.linalg.cholesky(rows.T @ rows + held @ held.T)
    seen = solve_triangular(lower, rows.T, lower=True).T.reshape(len(jacobian), 2, -1)
    return np.einsum("nik,njk->nij", seen, seen)


@pytest.mark.parametrize("num_images", [5, 60])
@pytest.mark.parametrize("gauge", ["inner", "two_cameras"])
def test_residuals_of_unit_covariance_scatter_as_weights_say(num_images, gauge):
    """Each observation twice, with residuals that are (1, 0) and (0, 1) when corrected for their
    leverage: M is half of H, and the residuals have variance 1/2.
    """
    exact = scene(
        num_images=num_images,
        num_points=4 * num_images + 20,
        track=8 if num_images > 8 else None,
        noise=0,
        perturbation=0,
    )
    values, vectors = np.linalg.eigh(np.eye(2) - leverages(exact) / 2)
    roots = np.einsum("nij,nj,nkj->nik", vectors, np.sqrt(values), vectors)
    twice = {name: np.repeat(getattr(exact, name), 2, axis=0) for name in OBSERVATIONS}
    twice["observation_xy"] = twice["observation_xy"] - roots.reshape(-1, 2)
    problem = exact.replace(**twice)
    whole = bundle.covariance(problem, gauge=gauge)
    scatter = bundle.covariance(problem, gauge=gauge, robust="sandwich")
    assert_same(scatter, whole, factor=0.5, tolerance=1e-7)
