"""Bounds: never left, and reported where they are met."""

import numpy as np
import pytest

import bundle
from tests.solving.constraints.lenses import BACKENDS, TO_THE_END, mixed, solve


@pytest.mark.parametrize("backend", BACKENDS)
def test_no_iterate_leaves_its_bounds(backend):
    problem = mixed()
    start = problem.camera_params[:, 0].tolist()
    rules = (
        f"camera 1: f in [{start[0] - 0.05!r}, {start[0] + 0.02!r}]",
        f"camera 2: fy in [-inf, {start[1] + 1!r}]",  # starts on it
        "cameras 2,4: k1 in [-0.031, 0.2]",
    )
    lower, upper = np.full((5, 8), -np.inf), np.full((5, 8), np.inf)
    lower[0, 0], upper[0, 0] = start[0] - 0.05, start[0] + 0.02
    upper[1, 1] = start[1] + 1
    lower[[1, 3], 4], upper[[1, 3], 4] = -0.031, 0.2
    for steps in range(8):
        solved = solve(problem, *rules, backend=backend, max_num_iterations=steps)
        params = solved.problem.camera_params
        assert ((params >= lower) & (params <= upper)).all(), steps
    ends = [bound for rule in solved.constraints for bound in rule.active_bounds]
    assert ends, "a scene on whose bounds nothing ends tests little"
    on = {(("camera", end.camera_id), end.parameter, end.side) for end in ends}
    assert on == set(solved.active_bounds)
    for end in ends:
        names = bundle.camera_models()[problem.camera_models[end.camera_id - 1]]
        assert params[end.camera_id - 1, names.index(end.parameter)] == end.value


@pytest.mark.parametrize("backend", BACKENDS)
def test_an_interval_without_length_holds(backend):
    problem = mixed()
    value = float(problem.camera_params[0, 0])
    held = solve(problem, "camera 1: f fixed", backend=backend)
    solved = solve(problem, f"camera 1: f in [{value!r}, {value!r}]", backend=backend)
    assert solved.problem.camera_params[0, 0] == value
    assert solved.constraints[0].active_bounds == ()
    np.testing.assert_array_equal(solved.problem.points, held.problem.points)


def test_the_closer_of_two_bounds_counts():
    problem = mixed()
    f, far = float(problem.camera_params[0, 0]), 1e4
    given = {("camera", 1): ([f - far, -far, -far, -far], [f + 0.01, far, far, far])}
    solver = bundle.Solver(
        problem,
        constraints=[f"camera 1: f in [{f - 0.02!r}, {f + far!r}]"],
        bounds=given,
        **TO_THE_END,
    )
    lower, upper = solver.bounds["camera", 1]
    assert (lower[0], upper[0]) == (f - 0.02, f + 0.01)
