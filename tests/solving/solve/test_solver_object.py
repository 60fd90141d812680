"""A solver that is used again and again: the bits of bundle.solve, each time."""

import multiprocessing
import os
import pickle
import signal
import threading

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import bundle
from bundle import _core
from tests import scenes
from tests.solving.fused.test_long_tracks import repeat_first_point
from tests.solving.fused.test_mixed_widths import with_full_opencv
from tests.solving.solve.test_far_origins import UTM, moved
from tests.solving.solve.test_observations_behind import crossing

TIMES = ("iteration_time_in_seconds", "cumulative_time_in_seconds")
RUNNING = {"function_tolerance": 0, "gradient_tolerance": 0, "parameter_tolerance": 0}


def with_other_values(problem, seed=0, size=3e-3):
    """Other poses, parameters, points and pixels in the same structure."""
    rng = np.random.default_rng(seed)

    def changed(array, scale):
        return array + size * scale * rng.standard_normal(array.shape)

    focal = problem.camera_params * [1, *[0] * (problem.camera_params.shape[1] - 1)]
    return problem.replace(
        cam_from_world=changed(problem.cam_from_world, 1),
        camera_params=problem.camera_params + 0.1 * size * focal * rng.standard_normal(),
        points=changed(problem.points, 1),
        observation_xy=changed(problem.observation_xy, 30),
    )


def assert_same(found, expected):
    """Every bit but for times, and how much memory the setup asked for."""
    for name in ("cam_from_world", "camera_params", "points"):
        np.testing.assert_array_equal(
            getattr(found.problem, name), getattr(expected.problem, name), err_msg=name
        )
    for name in ("factor_costs_before", "factor_costs_after"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    assert found.active_bounds == expected.active_bounds
    for name, array in expected.iterations.items():
        if name not in TIMES:
            np.testing.assert_array_equal(found.iterations[name], array, err_msg=name)
    for name, value in vars(expected.summary).items():
        if "time_in_seconds" not in name:
            assert getattr(found.summary, name) == value, name
    assert found.options == expected.options


def fixed_cost(problem):
    """Points that no free image sees, held: observations with nothing to refine."""
    images = problem.image_ids[:2]
    return problem, {
        "fixed_image_ids": images,
        "fixed_point_ids": problem.point_ids[:15],
        "fixed_camera_ids": problem.camera_ids[:2],
        "gauge": "none",
    }


SCENES = {
    "own cameras": lambda: (scenes.make_problem(num_images=8, num_points=300, track=4), {}),
    "bal": lambda: (scenes.scene(num_images=6, num_points=50), {}),
    "shared": lambda: (scenes.make_problem(num_images=7, num_points=80, shared=True), {}),
    "mixed": lambda: (with_full_opencv(scenes.make_problem(num_images=6, num_points=60), [2]), {}),
    "fixed cost": lambda: fixed_cost(scenes.make_problem(num_images=6, num_points=40)),
    "held": lambda: (crossing(), {"cheirality": "zero", "max_num_iterations": 22}),
    "far origin": lambda: (moved(scenes.make_problem(num_images=6), UTM), {}),
    "long tracks": lambda: (repeat_first_point(600), {"max_num_iterations": 3}),
    "three points": lambda: (scenes.make_problem(), {"gauge": "three_points"}),
    "loss": lambda: (scenes.make_problem(), {"loss": "cauchy", "loss_scale": 0.7}),
    "dogleg": lambda: (scenes.make_problem(), {"trust_region_strategy_type": "subspace_dogleg"}),
}


@pytest.mark.parametrize("name", SCENES)
def test_each_solve_has_the_bits_of_a_new_one(name):
    problem, options = SCENES[name]()
    options = {"backend": "fused", "num_threads": 2, "max_num_iterations": 6} | options
    solver = bundle.Solver(problem, **options)
    first, *others = problem, *(with_other_values(problem, seed) for seed in (1, 2))
    for values in (*others, first, others[0]):
        assert_same(solver.solve(values), bundle.solve(values, **options))
    assert_same(solver.solve(), bundle.solve(problem, **options))
    if name == "fixed cost":
        assert solver.solve().summary.fixed_cost > 0
    if name == "held":
        assert solver.solve().summary.warning_kinds


@pytest.mark.parametrize("num_threads", [1, 2, 3])
@pytest.mark.parametrize("linear", ["dense_schur", "sparse_schur", "iterative_schur"])
def test_every_linear_solver_on_any_number_of_threads(monkeypatch, linear, num_threads):
    monkeypatch.setattr("bundle._core.hardware_threads", lambda: 3)
    problem = scenes.make_problem(num_images=30, num_points=900, track=4, seed=3)
    other = with_other_values(problem, 5)
    for deterministic in (False, True):
        options = {
            "linear_solver_type": linear,
            "num_threads": num_threads,
            "deterministic": deterministic,
            "max_num_iterations": 5,
        }
        solver = bundle.Solver(problem, **options)
        for values in (other, problem, other):
            assert_same(solver.solve(values), bundle.solve(values, **options))


@pytest.mark.parametrize("kind", ["jacobi", "schur_power_series_expansion", "two_level"])
def test_every_preconditioner_starts_anew(kind):
    problem = scenes.make_problem(num_images=25, num_points=400, track=3, seed=4, shared=True)
    options = {
        "linear_solver_type": "iterative_schur",
        "preconditioner_type": kind,
        "max_num_iterations": 6,
    }
    solver = bundle.Solver(problem, **options)
    for seed in (1, 2):
        values = with_other_values(problem, seed, size=0.02)
        assert_same(solver.solve(values), bundle.solve(values, **options))


def test_solvers_of_several_structures_take_turns():
    problems = [
        scenes.make_problem(num_images=4 + k, num_points=50, track=3, seed=k) for k in range(3)
    ]
    solvers = [bundle.Solver(problem, num_threads=2) for problem in problems]
    for seed in (1, 2):
        for problem, solver in zip(problems, solvers, strict=True):
            values = with_other_values(problem, seed)
            assert_same(solver.solve(values), bundle.solve(values, num_threads=2))


def test_no_solve_does_symbolic_work():
    problem = scenes.make_problem(num_images=20, num_points=300, track=4)
    options = {"backend": "fused", "linear_solver_type": "sparse_schur"}
    solver = bundle.Solver(problem, **options)
    for values in (problem, with_other_values(problem)):
        result = solver.solve(values)
        assert result.summary.symbolic_time_in_seconds == 0
        assert result.build_time_in_seconds >= 0
        assert_same(result, bundle.solve(values, **options))
    assert bundle.solve(problem, **options).summary.symbolic_time_in_seconds > 0


def test_ceres_solves_from_scratch():
    problem = scenes.make_problem()
    options = {"backend": "ceres", "num_threads": 1}
    solver = bundle.Solver(problem, **options)
    for values in (with_other_values(problem), problem):
        assert_same(solver.solve(values), bundle.solve(values, **options))


def rolled(problem):
    """The same scene by cameras that were turned about their axes by 90 degrees."""
    turn = Rotation.from_rotvec([0, 0, np.pi / 2])
    poses = problem.cam_from_world
    rotations = turn * Rotation.from_quat(poses[:, :4].copy())
    middle = problem.camera_params[problem.image_camera[problem.observation_image], 1:3]
    x, y = (problem.observation_xy - middle).T
    return problem.replace(
        cam_from_world=np.hstack([rotations.as_quat(), turn.apply(poses[:, 4:].copy())]),
        observation_xy=middle + np.column_stack([-y, x]),
    )


def test_values_that_hold_another_gauge_are_laid_out_anew():
    """The coordinate that holds the scale is the largest of the second camera's baseline."""
    problem = scenes.make_problem(num_images=5, seed=2)
    options = {"backend": "fused", "gauge": "two_cameras"}
    solver = bundle.Solver(problem, **options)
    held = []
    for values in (rolled(problem), problem, rolled(problem)):
        result = solver.solve(values)
        assert_same(result, bundle.solve(values, **options))
        stayed = result.problem.cam_from_world[1, 4:] == values.cam_from_world[1, 4:]
        held.append(np.flatnonzero(stayed).tolist())
    assert held == [[1], [0], [1]]


def test_a_scene_may_move_away_from_its_origin_and_back():
    problem = scenes.make_problem(num_images=6)
    solver = bundle.Solver(problem, num_threads=2)
    for values in (moved(problem, UTM), problem, moved(problem, 2 * UTM)):
        result = solver.solve(values)
        assert_same(result, bundle.solve(values, num_threads=2))
        assert (result.summary.origin is None) == (values is problem)


def test_options_that_may_change_do():
    problem = scenes.make_problem(perturbation=0.03)
    solver = bundle.Solver(problem, backend="fused")
    for changes in (
        {"loss": "huber", "loss_scale": 0.3},
        {"initial_trust_region_radius": 1.0},
        {"max_num_iterations": 2},
        {"function_tolerance": 1e-2},
        {"gradient_tolerance": 1e3},
        {"parameter_tolerance": 1e-1},
        {"check_solution": False},
        {},
    ):
        assert set(changes) <= set(_core.changeable_options())
        found = solver.solve(**changes)
        assert_same(found, bundle.solve(problem, backend="fused", **changes))
    assert solver.options == solver.solve().options


@pytest.mark.parametrize(
    ("name", "value"),
    [("linear_solver_type", "sparse_schur"), ("refine", ["poses"]), ("num_threads", 1)],
)
def test_options_that_lay_out_the_solver_do_not(name, value):
    solver = bundle.Solver(scenes.make_problem(), num_threads=0, backend="fused")
    if getattr(solver.options, name) == value:
        pytest.skip("already so")
    with pytest.raises(
        bundle.InputError, match=f"^{name}: expected one of initial_trust_region_radius, "
    ):
        solver.solve(**{name: value})
    with pytest.raises(bundle.InputError, match="max_num_iteration"):
        solver.solve(max_num_iteration=3)


def changed_at(array, index, value):
    array = array.copy()
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("field", "change"),
    [
        (
            "observation_image",
            lambda p: changed_at(p.observation_image, 7, (p.observation_image[7] + 1) % 5),
        ),
        ("observation_point", lambda p: changed_at(p.observation_point, 9, 5)),
        ("image_camera", lambda p: changed_at(p.image_camera, 2, 0)),
        ("image_ids", lambda p: changed_at(p.image_ids, 1, 99)),
        ("camera_ids", lambda p: changed_at(p.camera_ids, 1, 99)),
        ("point_ids", lambda p: changed_at(p.point_ids, 5, 999)),
        (
            "camera_models",
            lambda p: changed_at(np.array(p.camera_models, "U20"), 1, "SIMPLE_RADIAL"),
        ),
    ],
)
@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_another_structure_is_refused(field, change, backend):
    problem = scenes.make_problem(model="PINHOLE", num_points=30, track=3)
    options = {"backend": backend, "num_threads": 1}  # with more, no two solves of Ceres' agree
    solver = bundle.Solver(problem, **options)
    values = change(problem)
    given = problem.replace(**{field: list(values) if field == "camera_models" else values})
    with pytest.raises(bundle.InputError, match=rf"^{field}: expected .* at index \d+, found "):
        solver.solve(given)
    assert_same(solver.solve(), bundle.solve(problem, **options))


@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_other_counts_are_refused(backend):
    problem = scenes.make_problem(num_images=5)
    solver = bundle.Solver(problem, backend=backend)
    for given in (
        scenes.make_problem(num_images=6),
        scenes.make_problem(num_points=41),
        scenes.make_problem(shared=True),
        scenes.make_problem(track=4),
        problem.replace(camera_params=np.pad(problem.camera_params, ((0, 0), (0, 1)))),
    ):
        with pytest.raises(bundle.InputError, match="expected the structure"):
            solver.solve(given)


def test_equal_arrays_elsewhere_are_the_same_structure():
    problem = scenes.make_problem(num_images=5)
    again = pickle.loads(pickle.dumps(problem))
    assert again.observation_image is not problem.observation_image
    assert_same(bundle.Solver(problem).solve(again), bundle.solve(again))


def raise_at(iteration, error):
    def progress(record):
        if record["iteration"] == iteration:
            raise error

    return progress


@pytest.mark.parametrize("linear", ["dense_schur", "sparse_schur", "iterative_schur"])
def test_it_recovers_from_whatever_ended_a_solve(linear):
    problem = scenes.make_problem(num_images=12, num_points=200, track=4, perturbation=0.05)
    options = {"linear_solver_type": linear, "num_threads": 2, "backend": "fused"}
    expected = bundle.solve(problem, **options)
    solver = bundle.Solver(problem, **options)
    with pytest.raises(RuntimeError, match="from the callback"):
        solver.solve(progress=raise_at(2, RuntimeError("from the callback")))
    assert_same(solver.solve(), expected)
    stopped = solver.solve(progress=raise_at(1, KeyboardInterrupt()))
    assert stopped.summary.interrupted
    assert len(stopped.iterations["cost"]) == 2
    assert_same(solver.solve(), expected)

    failing = problem.replace(camera_params=problem.camera_params * [1e200, 1, 1, 1])
    failed = solver.solve(failing)
    assert_same(failed, bundle.solve(failing, **options))
    assert failed.summary.termination_type == "FAILURE"
    assert_same(solver.solve(), expected)


def test_ctrl_c_stops_a_solve_of_a_solver():
    def interrupt(record):
        if record["iteration"] == 2:
            signal.raise_signal(signal.SIGINT)

    solver = bundle.Solver(scenes.make_problem(perturbation=0.05))
    assert solver.solve(progress=interrupt, **RUNNING).summary.interrupted
    assert not solver.solve().summary.interrupted


def test_one_solve_at_a_time():
    solver = bundle.Solver(scenes.make_problem())
    caught = []

    def again(_):
        try:
            solver.solve()
        except bundle.InputError as error:
            caught.append(str(error))

    result = solver.solve(progress=again)
    assert len(caught) == len(result.iterations["cost"])
    assert all("one solve at a time" in message for message in caught)
    assert_same(solver.solve(), result)


@pytest.mark.parametrize("backend", ["fused", "ceres"])
def test_threads_need_a_solver_each(backend):
    solver = bundle.Solver(scenes.make_problem(), backend=backend, num_threads=1)
    inside, leave = threading.Event(), threading.Event()

    def wait(_):
        inside.set()
        assert leave.wait(60)

    results = []
    thread = threading.Thread(target=lambda: results.append(solver.solve(progress=wait)))
    thread.start()
    assert inside.wait(60)  # which the GIL does not stand in the way of
    with pytest.raises(bundle.InputError, match="one solve at a time"):
        solver.solve()
    leave.set()
    thread.join()
    assert_same(solver.solve(), results[0])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_it_survives_a_fork():
    """Its threads do not: the child must wait for none of them."""
    problem = scenes.make_problem(num_points=300)
    solver = bundle.Solver(problem, num_threads=2, backend="fused")
    expected = solver.solve().problem.points
    context = multiprocessing.get_context("fork")
    queue = context.SimpleQueue()

    def solve():
        queue.put([solver.solve().problem.points.tobytes() for _ in range(2)])

    child = context.Process(target=solve)
    child.start()
    child.join(60)
    assert child.exitcode == 0
    assert queue.get() == 2 * [expected.tobytes()]
    np.testing.assert_array_equal(solver.solve().problem.points, expected)


def test_it_pickles_as_problem_and_options():
    solver = bundle.Solver(scenes.make_problem(), loss="huber", num_threads=2)
    again = pickle.loads(pickle.dumps(solver))
    assert again.options == solver.options
    assert_same(again.solve(), solver.solve())


def test_it_shows_itself():
    solver = bundle.Solver(scenes.make_problem(num_images=5), loss="huber")
    assert "5 images" in repr(solver)
    assert "loss='huber'" in repr(solver)
    assert "function_tolerance" not in repr(solver)  # which has its default
    assert "<table>" in solver._repr_html_()


def test_it_says_at_once_what_it_cannot_do():
    problem = scenes.make_problem()
    with pytest.raises(bundle.InputError, match=r"^fixed_image_ids: .*99"):
        bundle.Solver(problem, fixed_image_ids=[99])
    with pytest.raises(bundle.InputError, match=r"^linear_solver_type: .*fused"):
        bundle.Solver(problem, backend="fused", linear_solver_type="cgnr")
    with pytest.raises(bundle.InputError, match=r"^progress"):
        bundle.Solver(problem).solve(progress=3)
