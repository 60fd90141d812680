"""Bounds of camera parameters: the fused backend takes the steps that Ceres takes with them."""

import numpy as np
import pytest

import bundle
from tests import scenes
from tests.solving.fused.measured_steps import first_measured

BACKENDS = ("fused", "ceres")


def parameters_of(problem, index):
    return bundle.camera_models()[problem.camera_models[index]]


def around(problem, cameras=None, **widths):
    """Bounds around the start: a number for both sides, or (below, above)."""
    bounds = {}
    for index in range(problem.num_cameras) if cameras is None else cameras:
        names = parameters_of(problem, index)
        lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
        for name, width in widths.items():
            j = names.index(name)
            below, above = width if isinstance(width, tuple) else (width, width)
            lower[j] = problem.camera_params[index, j] - below
            upper[j] = problem.camera_params[index, j] + above
        bounds["camera", int(problem.camera_ids[index])] = lower, upper
    return bounds


def solve_both(problem, bounds, **options):
    settings = {
        "function_tolerance": 1e-11,  # beyond that, rounding decides
        "parameter_tolerance": 0.0,
        "max_num_iterations": 10,
        "linear_solver_type": "dense_schur",
        "num_threads": 2,
        **options,
    }
    return tuple(
        bundle.solve(problem, bounds=bounds, backend=backend, **settings) for backend in BACKENDS
    )


def assert_same_steps(problem, bounds, **options):
    ours, theirs = solve_both(problem, bounds, **options)
    found, expected = ours.iterations, theirs.iterations
    assert len(found["cost"]) == len(expected["cost"])
    assert found["step_is_successful"].tolist() == expected["step_is_successful"].tolist()
    np.testing.assert_allclose(found["cost"], expected["cost"], rtol=1e-9)
    scale = expected["gradient_max_norm"].max()
    np.testing.assert_allclose(
        found["gradient_max_norm"], expected["gradient_max_norm"], rtol=1e-6, atol=1e-9 * scale
    )
    begin = first_measured(expected)
    np.testing.assert_allclose(
        found["step_norm"][begin:], expected["step_norm"][begin:], rtol=1e-5, atol=1e-9
    )
    assert ours.active_bounds == theirs.active_bounds
    np.testing.assert_allclose(
        ours.problem.camera_params, theirs.problem.camera_params, rtol=1e-8, atol=1e-9
    )
    for (_, camera_id), (lower, upper) in bounds.items():
        index = problem.camera_ids.tolist().index(camera_id)
        params = ours.problem.camera_params[index, : len(lower)]
        assert (params >= lower).all() and (params <= upper).all()
    return ours


STRATEGIES = ("levenberg_marquardt", "dogleg", "subspace_dogleg")


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize(
    "widths",
    [
        {"f": 0.5},
        {"f": (0.0, 1.0)},  # starts on a bound
        {"k": 1e-3},
        {"f": (0.2, 5), "k": (1e-2, 1e-4)},
        {"f": 1e4, "k": 100},  # none that matters
    ],
)
@pytest.mark.parametrize("shared", [False, True])
def test_same_steps(strategy, widths, shared):
    problem = scenes.make_problem(shared=shared, perturbation=3e-2, seed=5)
    assert_same_steps(problem, around(problem, **widths), trust_region_strategy_type=strategy)


@pytest.mark.parametrize(
    "options",
    [
        {"linear_solver_type": "sparse_schur", "loss": "cauchy", "loss_scale": 2.0},
        {"linear_solver_type": "iterative_schur", "preconditioner_type": "schur_jacobi"},
        {"loss": "huber", "loss_scale": 1.0, "trust_region_strategy_type": "dogleg"},
        {"refine": "poses,points,focal,principal_point,extra", "gauge": "two_cameras"},
    ],
)
def test_same_steps_with_other_options(options):
    problem = scenes.make_problem(model="RADIAL", perturbation=3e-2, seed=7)
    bounds = around(problem, cameras=(0, 2, 3), f=(1.0, 0.3), k1=1e-3)
    result = assert_same_steps(problem, bounds, **options)
    assert result.active_bounds


def test_same_steps_with_factors():
    problem = scenes.make_problem(shared=True, perturbation=3e-2, seed=7)
    params = problem.camera_params[0]
    factors = [
        bundle.PriorFactor(("camera", 1), params + np.array([5, 0, 0, 0.01]), 1.0),
        bundle.PriorFactor(("point", 3), problem.points[2], 100.0),
    ]
    bounds = around(problem, f=(1.0, 2.0))
    result = assert_same_steps(problem, bounds, factors=factors, gauge="two_cameras")
    assert result.active_bounds


@pytest.mark.parametrize(
    ("strategy", "seed"), [("levenberg_marquardt", 2), ("levenberg_marquardt", 3), ("dogleg", 2)]
)
def test_the_search_along_a_step_takes_ceres_steps(strategy, seed):
    """Bounds far away, and a start so bad that whole steps raise the cost."""
    problem = scenes.make_problem(perturbation=0.5, num_points=25, seed=seed)
    options = {"cheirality": "algebraic", "trust_region_strategy_type": strategy}
    bounded = assert_same_steps(problem, around(problem, f=1e5), **options)
    free, _ = solve_both(problem, None, **options)
    assert not free.iterations["step_is_successful"][:5].all()
    assert bounded.iterations["step_is_successful"][:5].all()


def test_threads_do_not_change_a_bit_where_that_is_asked_for():
    problem = scenes.make_problem(num_images=6, num_points=300, perturbation=3e-2, seed=3)
    bounds = around(problem, f=(0.5, 0.5), k=1e-3)
    one, two = (
        bundle.solve(
            problem,
            bounds=bounds,
            deterministic=True,
            num_threads=threads,
            backend="fused",
            max_num_iterations=8,
        )
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one.iterations["cost"], two.iterations["cost"])
    np.testing.assert_array_equal(one.problem.camera_params, two.problem.camera_params)
