"""Bounds of camera parameters in a solve: what they keep, where it ends, bad input."""

import pickle

import numpy as np
import pytest

import bundle
from tests import scenes

NONE = np.inf
BACKENDS = ("fused", "ceres")
# f cx cy k of SIMPLE_RADIAL.
FREE = [-NONE] * 4, [NONE] * 4


def with_bounds(problem, camera=0, **limits):
    lower, upper = np.full(4, -NONE), np.full(4, NONE)
    for name, (low, high) in limits.items():
        j = ("f", "cx", "cy", "k").index(name)
        lower[j], upper[j] = low, high
    return {("camera", int(problem.camera_ids[camera])): (lower, upper)}


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("side", ["lower", "upper"])
def test_a_focal_length_ends_on_its_bound_and_all_else_at_its_optimum(backend, side):
    """As if the focal length was held there, although the step of everything else starts there."""
    problem = scenes.make_problem(perturbation=2e-2, shared=True)
    free = bundle.solve(problem, gauge="two_cameras").problem.camera_params[0, 0]
    f = free + (4 if side == "lower" else -4)
    start = f + (6 if side == "lower" else -6)
    params = problem.camera_params.copy()
    params[0, 0] = start
    problem = problem.replace(camera_params=params)
    bounds = with_bounds(problem, f=(f, NONE) if side == "lower" else (-NONE, f))
    settings = {"backend": backend, "function_tolerance": 1e-14, "max_num_iterations": 200}
    result = bundle.solve(problem, bounds=bounds, **settings)
    assert result.problem.camera_params[0, 0] == f
    assert result.active_bounds == ((("camera", 1), "f", side),)
    assert not result.summary.warnings
    params[0, 0] = f
    held = bundle.solve(
        problem.replace(camera_params=params),
        bounds=with_bounds(problem, f=(f, f)),
        **settings,
    )
    assert held.active_bounds == ()
    assert result.summary.final_cost == pytest.approx(held.summary.final_cost, rel=1e-9)
    np.testing.assert_allclose(
        result.problem.camera_params, held.problem.camera_params, rtol=1e-4, atol=1e-6
    )
    again = pickle.loads(pickle.dumps(result))
    assert again.active_bounds == result.active_bounds
    assert "f of camera 1" in repr(result)


def test_the_rounding_of_a_qr_factorisation_takes_nothing_off_its_bound():
    """Its numbers are off by 1e-9 where derivatives are zero: enough to be no longer on a bound."""
    problem = scenes.make_problem(num_images=6, perturbation=2e-2)
    bounds = {}
    for camera in range(6):
        f, _, _, k = problem.camera_params[camera]
        bounds |= with_bounds(problem, camera, f=(f - 0.3, f + 0.5), k=(k - 2e-4, k + 1e-4))
    settings = {"backend": "ceres", "gauge": "two_cameras", "function_tolerance": 1e-14}
    expected, found = (
        bundle.solve(problem, bounds=bounds, linear_solver_type=solver, **settings)
        for solver in ("dense_normal_cholesky", "dense_qr")
    )
    assert len(expected.active_bounds) > 6
    assert found.active_bounds == expected.active_bounds
    assert found.summary.final_cost == pytest.approx(expected.summary.final_cost, rel=1e-10)


@pytest.mark.parametrize("backend", BACKENDS)
def test_equal_bounds_hold_one_parameter(backend):
    problem = scenes.make_problem(perturbation=2e-2)
    k = problem.camera_params[2, 3]
    result = bundle.solve(problem, bounds=with_bounds(problem, 2, k=(k, k)), backend=backend)
    moved = result.problem.camera_params != problem.camera_params
    assert not moved[2, 3]
    assert moved[2, 0] and moved[[0, 1, 3, 4], 3].all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_bounds_of_what_is_not_refined_change_nothing(backend):
    problem = scenes.make_problem()
    cx = problem.camera_params[0, 1]
    plain = bundle.solve(problem, backend=backend, num_threads=1)
    bounded = bundle.solve(
        problem, bounds=with_bounds(problem, cx=(cx - 1, cx)), backend=backend, num_threads=1
    )
    np.testing.assert_array_equal(bounded.iterations["cost"], plain.iterations["cost"])
    np.testing.assert_array_equal(bounded.problem.points, plain.problem.points)
    assert bundle.solve(problem, bounds={}, backend=backend).active_bounds == ()


def changed(side, j, value):
    bounds = [list(FREE[0]), list(FREE[1])]
    bounds[side][j] = value
    return {("camera", 1): tuple(bounds)}


@pytest.mark.parametrize(
    ("bounds", "words"),
    [
        ([1], ["bounds", "mapping", "[1]"]),
        ({"camera": FREE}, ["bounds", "('camera', id)", "'camera'"]),
        ({("image", 1): FREE}, ["('camera', id)", "('image', 1)"]),
        ({("camera", True): FREE}, ["('camera', id)", "True"]),
        ({("camera", 9): FREE}, ["no camera 9"]),
        ({("camera", 1): 3}, ["camera 1", "(lower, upper)", "3"]),
        ({("camera", 1): FREE + FREE}, ["camera 1", "(lower, upper)"]),
        ({("camera", 1): (FREE[0][:3], FREE[1])}, ["camera 1: lower", "4 numbers (f, cx", "(3,)"]),
        ({("camera", 1): (FREE[0], "x")}, ["camera 1: upper", "numbers", "'x'"]),
        (changed(1, 3, np.nan), ["camera 1: upper", "nan (k)"]),
        (changed(0, 0, 900.0), ["camera 1: f", "[900, inf]", "found"]),
        (changed(1, 3, -0.5), ["camera 1: k", "[-inf, -0.5]", "found"]),
        ({("camera", 1): ([-NONE, 3, 0, 0], [NONE, 2, 0, 0])}, ["camera 1: cx", "(2)", "found 3"]),
    ],
)
def test_bad_bounds_are_refused_in_one_line(bounds, words):
    problem = scenes.make_problem(shared=True)
    with pytest.raises(bundle.InputError) as refused:
        bundle.solve(problem, bounds=bounds)
    message = str(refused.value)
    assert "\n" not in message
    for word in words:
        assert word in message
