"""A few positions beside many pixels: what the default tolerances leave to go."""

import numpy as np
import pytest

import bundle
from bundle import PositionPrior
from tests.georeference.flights import flight

EXACT = {
    "function_tolerance": 1e-16,
    "gradient_tolerance": 0.0,
    "parameter_tolerance": 1e-14,
    "max_num_iterations": 300,
}


def flown(num_points=400):
    """A model that pixels alone have refined, and its measured positions, one of them wrong."""
    problem = flight([], seed=3, noise=0.5, num_points=num_points, start_noise=0.02).problem
    problem = bundle.solve(problem, gauge="two_cameras", convergence="ceres").problem
    rng = np.random.default_rng(4)
    measured = problem.projection_centers + rng.normal(0, 0.5, (problem.num_images, 3))
    measured[5, 0] += 30
    return problem, measured


def priors(problem, measured, loss="trivial", sigma=2.0, scale=2.795):
    ids = problem.image_ids.tolist()
    return [
        PositionPrior(i, place, sigma, loss=loss, loss_scale=scale)
        for i, place in zip(ids, measured, strict=True)
    ]


def farthest(a, b):
    return np.linalg.norm(a.problem.projection_centers - b.problem.projection_centers, axis=1).max()


@pytest.mark.parametrize("backend", ["fused", "ceres"])
@pytest.mark.parametrize("loss", ["huber", "cauchy", "arctan"])
def test_defaults_end_where_exact_solves_do(backend, loss):
    problem, measured = flown()
    known = priors(problem, measured, loss)
    found = bundle.solve(problem, priors=known, backend=backend)
    exact = bundle.solve(problem, priors=known, backend="fused", **EXACT)
    away = np.linalg.norm(
        exact.problem.projection_centers - found.problem.projection_centers, axis=1
    )
    assert away.max() < 2e-3
    assert found.summary.termination_type == "CONVERGENCE"
    assert found.summary.final_cost == pytest.approx(exact.summary.final_cost, rel=1e-9)
    records = found.iterations["cost"]
    assert len(records) == found.summary.num_successful_steps + found.summary.num_unsuccessful_steps
    assert found.iterations["iteration"].tolist() == list(range(len(records)))


@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_factors_beside_others_of_a_larger_cost(backend):
    # The kind of a factor counts: priors on lenses of a large cost do not drown positions.
    problem, measured = flown(150)
    lenses = [
        bundle.PriorFactor(("camera", c), problem.camera_params[row] + [40, 0, 0, 0], 1e4)
        for row, c in enumerate(problem.camera_ids.tolist())
    ]
    known = priors(problem, measured, "huber")
    options = {"factors": lenses, "priors": known, "align": True, "refine": ["poses", "points"]}
    found = bundle.solve(problem, backend=backend, **options)
    exact = bundle.solve(problem, backend="fused", **options, **EXACT)
    assert farthest(found, exact) < 2e-3


@pytest.mark.parametrize("backend", ["fused", "ceres"])
@pytest.mark.parametrize("sigma", [0.02, 50.0])
def test_weights_of_any_size(backend, sigma):
    problem, measured = flown(150)
    measured[5, 0] -= 30
    known = priors(problem, measured, sigma=sigma)
    found = bundle.solve(problem, priors=known, backend=backend)
    exact = bundle.solve(problem, priors=known, backend="fused", **EXACT)
    assert found.summary.termination_type == "CONVERGENCE"
    assert farthest(found, exact) < 1e-3 * max(1, sigma)


def test_a_limit_of_steps_holds_beside_factors():
    problem, measured = flown(150)
    known = priors(problem, measured, "huber")
    for backend in ("fused", "ceres"):
        found = bundle.solve(problem, priors=known, backend=backend, max_num_iterations=3)
        assert found.iterations["iteration"].max() == 3
        assert found.summary.termination_type == "NO_CONVERGENCE"


def test_factors_that_fit_perfectly_converge():
    problem, _ = flown(150)
    known = priors(problem, problem.projection_centers, sigma=1e-3)
    for backend in ("fused", "ceres"):
        found = bundle.solve(problem, priors=known, align=False, backend=backend)
        assert found.summary.termination_type == "CONVERGENCE"
        assert len(found.iterations["cost"]) < 12


def test_solves_without_factors_stay_as_they_are():
    problem = flight([], seed=1, num_points=60, start_noise=0.05).problem
    fused, ceres = (bundle.solve(problem, backend=b) for b in ("fused", "ceres"))
    assert len(fused.iterations["cost"]) == len(ceres.iterations["cost"])
    assert fused.iterations["trust_region_radius"].max() < 1e9
