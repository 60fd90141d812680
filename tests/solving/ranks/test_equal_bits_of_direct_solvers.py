"""Direct solvers end at the same bits for any number of processes that has whole sections."""

import numpy as np
import pytest

import bundle
from bundle import _core
from bundle.solving.ranks.partition import divide
from tests.rig_scenes import rig_problem
from tests.solving.ranks.test_equal_bits import CASES, mixed_widths, positions, street
from tests.solving.ranks.thread_crew import alone_and_divided

OPTIONS = {"linear_solver_type": "sparse_schur", "max_num_iterations": 8}


def solves(problem, num_ranks, **options):
    return alone_and_divided(problem, num_ranks, **(OPTIONS | options))


def assert_same_bits(alone, divided):
    for name in alone.iterations:
        if not name.endswith("time_in_seconds"):
            np.testing.assert_array_equal(
                divided.iterations[name], alone.iterations[name], err_msg=name
            )
    for name in ("cam_from_world", "camera_params", "points"):
        np.testing.assert_array_equal(
            getattr(divided.problem, name), getattr(alone.problem, name), err_msg=name
        )


@pytest.mark.parametrize("num_ranks", [1, 2, 3, 4, 6, 12])
@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur"])
@pytest.mark.parametrize("strategy", ["levenberg_marquardt", "dogleg", "subspace_dogleg"])
def test_steps_of(num_ranks, solver, strategy):
    """Doglegs make the most of rounding: one bit of a sum would be seen in all that follows."""
    options = {"linear_solver_type": solver, "trust_region_strategy_type": strategy}
    alone, divided = solves(street(), num_ranks, **options)
    assert len(alone.iterations["cost"]) > 4
    assert_same_bits(alone, divided)


@pytest.mark.parametrize("case", CASES)
def test_with(case):
    make, options = CASES[case]
    solver = {"gauge": "none", "trust_region_strategy_type": "dogleg"}
    assert_same_bits(*solves(make(), 3, **(solver | options)))


def test_with_factors_of_images():
    problem = street()
    assert_same_bits(*solves(problem, 4, factors=positions(problem)))


def test_with_bounds_on_which_steps_end():
    problem = street(rotation_noise=0.5)
    lower, upper = np.full((2, problem.camera_params.shape[1]), [[-np.inf], [np.inf]])
    focal = problem.camera_params[0, 0]
    lower[0], upper[0] = 0.9999 * focal, 1.0001 * focal
    bounds = {("camera", int(problem.camera_ids[0])): (lower, upper)}
    alone, divided = solves(problem, 3, bounds=bounds)
    assert any(alone.active_bounds)
    assert_same_bits(alone, divided)


def test_conjugate_gradients_on_few_columns():
    """They are on no grid."""
    problem = bundle.synthesize(scene="street", num_images=8, num_points=200, seed=3).problem
    alone, divided = solves(problem, 4, linear_solver_type="iterative_schur")
    assert_same_bits(alone, divided)


def test_with_refined_sensors():
    alone, divided = solves(
        rig_problem(num_frames=18, num_points=120),
        3,
        linear_solver_type="sparse_schur",
        refine=("poses", "points", "focal", "extra", "sensor_from_rig"),
    )
    assert_same_bits(alone, divided)


def test_a_system_in_several_messages():
    """And, with 1,170 columns, factorised in tiles by two threads and by one."""
    problem = street(num_images=130, num_points=1500, cameras="individual")
    alone, divided = solves(
        problem,
        3,
        linear_solver_type="dense_schur",
        trust_region_strategy_type="dogleg",
        max_num_iterations=3,
    )
    (sent,) = (
        kind for kind in divided.summary.processes.traffic if kind.what == "normal equations"
    )
    assert sent.num_messages > 2 * divided.summary.num_jacobian_evaluations
    assert_same_bits(alone, divided)


def test_a_rejected_try_far_away():
    """Its cost is a thousand times the last one, and shows each digit of its step."""
    problem = street(rotation_noise=3.0, translation_noise=0.5, point_noise=1.0)
    alone, divided = solves(problem, 4, max_num_iterations=30)
    rejected = ~np.asarray(alone.iterations["step_is_successful"])
    assert rejected[1:].any()
    assert_same_bits(alone, divided)


def test_processes_that_divide_sections_agree_to_rounding():
    problem = street()
    assert _core.num_point_sections(len(problem.observation_xy)) % 5
    alone, divided = solves(problem, 5)
    np.testing.assert_allclose(divided.iterations["cost"], alone.iterations["cost"], rtol=1e-9)


@pytest.mark.parametrize("num_parts", [1, 2, 3, 4, 6, 12])
def test_a_part_has_whole_sections(num_parts):
    problem = mixed_widths()
    division = divide(problem, num_parts)
    sections = [set(division.section[part]) for part in division.parts]
    assert sum(map(len, sections)) == len(set().union(*sections))
    lengths = np.bincount(problem.observation_point)
    observations = [lengths[part].sum() for part in division.parts]
    assert max(observations) - min(observations) <= 2 * lengths.max()


@pytest.mark.parametrize(
    ("num_observations", "expected"),
    [(0, 12), (1, 12), (393215, 12), (393216, 24), (20_000_000, 768), (2**40, 768)],
)
def test_the_number_of_sections(num_observations, expected):
    assert _core.num_point_sections(num_observations) == expected


def test_double_doubles_of_several_processes():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(6, 1000)) * 10.0 ** rng.integers(-12, 12, (6, 1000))

    def added(order):
        sums, errors = np.zeros(1000), np.zeros(1000)
        for k in order:
            _core.add_double_doubles(values[k], np.zeros(1000), sums, errors)
        return sums + errors

    forwards, backwards = added(range(6)), added(range(5, -1, -1))
    np.testing.assert_array_equal(forwards, backwards)
    assert (sum(values) != sum(values[::-1])).any()
    exact = np.array([np.longdouble(0)] * 1000)
    for row in values:
        exact += row.astype(np.longdouble)
    np.testing.assert_allclose(forwards, exact.astype(float), rtol=1e-15)
    with pytest.raises(bundle.InputError):
        _core.add_double_doubles(np.zeros(2), np.zeros(2), np.zeros(3), np.zeros(3))
