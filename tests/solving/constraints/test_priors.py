"""Priors: between fixed and free, with the cost that they say they have."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import bundle
from tests import scenes
from tests.solving.constraints.lenses import (
    BACKENDS,
    IN_PLACE,
    TO_THE_END,
    assert_same,
    mixed,
    solve,
)

# A prior with its sigma left open, and the rule that is its limit; values as at the start.
KINDS = {
    "pixels": ("camera 1: f prior sigma {}", "camera 1: f fixed"),
    "logarithm": ("cameras 1-2: f prior {} %", "cameras 1-2: f fixed"),
    "distortion": ("cameras 2,4: k1,p2 prior sigma {}", "cameras 2,4: k1,p2 fixed"),
    "rotation": ("image 4: rotation prior sigma {}", "image 4: rotation fixed"),
    "point": ("points 3-4: position prior sigma {}", "points 3-4: position fixed"),
}


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_small_sigma_holds_and_a_large_one_does_nothing(kind, backend):
    problem = mixed(num_points=60)
    prior, fixed = KINDS[kind]
    weak = "cameras 2,4: k2 fixed"  # what 60 points do not say to 1e-8
    options = {"backend": backend, **(IN_PLACE if kind in ("rotation", "point") else {})}
    assert_same(
        solve(problem, weak, prior.format("1e-8"), **options),
        solve(problem, weak, fixed, **options),
    )
    assert_same(
        solve(problem, weak, prior.format("1e9"), **options), solve(problem, weak, **options)
    )


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_small_sigma_of_a_position_holds_the_centre(backend):
    problem = mixed()
    rule = "image 4: position prior [0.5, 0.1, -4] sigma {}"
    held = solve(problem, rule.format("1e-9"), backend=backend)
    np.testing.assert_allclose(held.problem.projection_centers[3], [0.5, 0.1, -4], atol=1e-8)
    assert_same(
        solve(problem, rule.format("1e9"), backend=backend), solve(problem, backend=backend)
    )


@pytest.mark.parametrize("relative", [False, True])
def test_costs_are_those_of_dense_least_squares(relative):
    problem = scenes.make_problem(num_images=3, num_points=12, shared=True)
    value, spread = float(problem.camera_params[0, 0]) * 1.02, "1 %" if relative else "sigma 7"
    rules = f"camera 1: f prior {value!r} {spread}", "camera 1: k prior 0 sigma 1e-3"
    solved = solve(problem, *rules, gauge="none", fixed_image_ids=(1, 2))

    def residual(x):
        w, t = np.zeros((3, 3)), problem.cam_from_world[:, 4:].copy()
        w[2], t[2] = x[:3], x[3:6]
        params = problem.camera_params.copy()
        params[0, [0, 3]] = x[6:8]
        pixels = scenes.residuals(problem, w, t, params, x[8:].reshape(-1, 3))
        f = np.log(x[6] / value) / 0.01 if relative else (x[6] - value) / 7
        return np.r_[pixels.ravel(), f, x[7] / 1e-3]

    start = np.r_[
        np.zeros(3),
        problem.cam_from_world[2, 4:],
        problem.camera_params[0, [0, 3]],
        problem.points.ravel(),
    ]
    dense = least_squares(residual, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(solved.summary.final_cost, dense.cost, rtol=1e-9)
    np.testing.assert_allclose(
        solved.problem.camera_params[0, [0, 3]], dense.x[6:8], rtol=1e-6, atol=1e-9
    )
    (f,), (k,) = (rule.priors for rule in solved.constraints)
    np.testing.assert_allclose(
        [f.pull, k.pull], residual(np.r_[dense.x])[-2:], rtol=1e-4, atol=1e-9
    )
    np.testing.assert_allclose(solved.factor_costs_after, [f.pull**2 / 2, k.pull**2 / 2])


def test_both_backends_take_the_same_steps():
    problem = mixed()
    rules = (
        "cameras *: f prior 1 %",
        "cameras *: k1 prior 0 sigma 0.01",
        "image 3: rotation prior sigma 0.2",
        "image 5: position prior sigma [0.1, 0.1, 0.5]",
        "point 7: position prior [0, 0, 0] sigma 0.3",
        "image 2: rotation fixed",
        "camera 5: k fixed",
    )
    ours, theirs = (
        bundle.solve(
            problem,
            constraints=rules,
            backend=backend,
            linear_solver_type="dense_schur",
            max_num_iterations=6,
        )
        for backend in BACKENDS
    )
    assert ours.options.gauge == "none"
    np.testing.assert_allclose(ours.iterations["cost"], theirs.iterations["cost"], rtol=1e-9)
    assert_same(ours, theirs, 1e-6)
    np.testing.assert_array_equal(ours.problem.camera_params[4, 3], problem.camera_params[4, 3])
    np.testing.assert_array_equal(ours.problem.cam_from_world[1, :4], problem.cam_from_world[1, :4])
    assert (ours.problem.cam_from_world[1, 4:] != problem.cam_from_world[1, 4:]).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_pulls_are_the_lengths_of_the_factors(backend):
    problem = mixed()
    solved = solve(
        problem,
        "image 4: rotation prior sigma 0.01",
        "image 4: position prior [0.6, 0, -3.9] sigma 0.02/0.05",
        "points 3-4: position prior sigma [0.001, 0.002, 0.003]",
        "camera 2: f prior 1100 sigma 4",
        backend=backend,
    )
    pulls = [prior.pull for rule in solved.constraints for prior in rule.priors]
    assert len(pulls) == 6  # two of the points, fx and fy
    np.testing.assert_allclose(0.5 * np.square(pulls), solved.factor_costs_after, rtol=1e-6)
    assert solved.constraints[0].priors[0].before == tuple(problem.cam_from_world[3, :4])
    position = solved.constraints[1].priors[0]
    assert position.sigma == (0.02, 0.02, 0.05)
    np.testing.assert_allclose(position.after, solved.problem.projection_centers[3], atol=1e-12)


def test_a_percentage_is_of_the_start_in_every_round():
    problem = mixed()
    rule = "cameras *: f prior 0.01 %"
    solved = bundle.solve_rounds(
        problem, constraints=[rule], num_rounds=3, max_error=1.2, min_angle=0, gauge="two_cameras"
    )
    assert len(solved.rounds) > 1
    (end,) = solved.constraints
    assert [prior.known[0] for prior in end.priors[:1]] == [problem.camera_params[0, 0]]
    assert end.num_parameters == len(end.priors) == 7  # one of three lenses, two of two


def test_a_prior_on_a_camera_that_nothing_sees():
    problem = mixed()
    params = np.vstack([problem.camera_params, problem.camera_params[:1]])
    problem = problem.replace(
        camera_ids=[*problem.camera_ids, 99],
        camera_models=[*problem.camera_models, problem.camera_models[0]],
        camera_params=params,
        camera_sizes=[*problem.camera_sizes, [1, 1]],
    )
    for backend in BACKENDS:
        solved = solve(problem, "camera 99: f prior 2000 sigma 1", backend=backend)
        np.testing.assert_allclose(solved.problem.camera_params[5, 0], 2000, rtol=1e-9)
        np.testing.assert_array_equal(solved.problem.camera_params[5, 1:], params[5, 1:])
        held = solve(problem, "cameras 99: f,k fixed", backend=backend)
        np.testing.assert_array_equal(held.problem.camera_params[5], params[5])


def test_a_solver_object_and_its_pickle_keep_the_rules():
    import pickle

    problem = mixed()
    rules = ["camera 1: f fixed", "camera 2: k1 in [-1, 1]", "camera 3: f prior 1 %"]
    solver = bundle.Solver(problem, constraints=rules, **TO_THE_END)
    again = pickle.loads(pickle.dumps(solver))
    first, second = solver.solve(), again.solve()
    expected = solve(problem, *rules)
    for found in (first, second):
        np.testing.assert_array_equal(found.problem.camera_params, expected.problem.camera_params)
        assert len(found.constraints) == 3
    assert [str(rule) for rule in again.constraints] == [str(rule) for rule in solver.constraints]
    moved = problem.replace(camera_params=problem.camera_params * 1.001)
    np.testing.assert_array_equal(
        solver.solve(moved).problem.camera_params[0, 0], moved.camera_params[0, 0]
    )
