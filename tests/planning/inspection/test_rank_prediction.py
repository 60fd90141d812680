"""Predicted and measured costs of several processes."""

import math

import pytest

import bundle
from bundle.planning.inspection.problem_pattern import find_pattern
from bundle.planning.inspection.rank_prediction import predict_ranks, step_bytes
from bundle.solving.layout import resolve_defaults
from tests.solving.ranks.thread_crew import processes

STREET = {"scene": "street", "num_images": 30, "num_points": 600, "seed": 2}


@pytest.fixture(scope="module")
def problem():
    return bundle.synthesize(**STREET).problem


@pytest.fixture(scope="module")
def inspection(problem):
    return bundle.inspect(problem, num_threads=1)


@pytest.mark.parametrize("solver", ["dense_schur", "sparse_schur"])
def test_bytes_of_a_step_are_those_that_are_sent(problem, solver):
    options = resolve_defaults(problem, bundle.SolveOptions(num_threads=1))
    reduced = find_pattern(problem, options).reduced
    predicted = step_bytes(reduced, is_dense=solver == "dense_schur", double_doubles=True)
    assert reduced.sums_are_double_doubles(solver.upper())
    with processes(2):
        summary = bundle.solve(
            problem, num_threads=1, max_num_iterations=5, linear_solver_type=solver
        ).summary
    # An accepted step linearises anew; the last linearisation has no step.
    of = {kind.what: kind.num_bytes for kind in summary.processes.traffic}
    linearised = (of["normal equations"] + of["gradient"]) / summary.num_jacobian_evaluations
    sent = linearised + of["step"] / summary.num_linear_solves
    assert predicted == pytest.approx(sent, rel=1e-12)
    assert of["scalars"] / summary.num_jacobian_evaluations < 0.05 * predicted


def test_more_processes(problem, inspection):
    one, two, many = predict_ranks(problem, inspection, counts=[1, 2, 600], network=(10, 50))
    best = min(
        method.time_per_step_in_seconds
        for method in inspection.methods
        if method.backend == "FUSED" and method.is_taken
    )
    assert one.time_per_step_in_seconds == pytest.approx(best)
    assert one.efficiency == pytest.approx(1)
    for row in (one, two, many):
        parts = row.points_time_per_step_in_seconds + row.first_time_per_step_in_seconds
        whole = parts + row.network_time_per_step_in_seconds
        assert whole == pytest.approx(row.time_per_step_in_seconds)
    assert two.points_time_per_step_in_seconds < one.points_time_per_step_in_seconds
    assert (one.bytes_per_step, one.network_time_per_step_in_seconds) == (0, 0)
    assert one.most_observations == len(problem.observation_xy)
    assert one.most_observations / 2 <= two.most_observations < 0.6 * one.most_observations
    assert many.most_observations < 30  # a track
    assert two.efficiency == pytest.approx(best / (2 * two.time_per_step_in_seconds))
    assert two.memory_of_others_in_bytes < two.memory_of_first_in_bytes
    assert many.memory_of_others_in_bytes < two.memory_of_others_in_bytes


def test_files_are_kept_by_one_process_and_divided_among_several(problem, inspection):
    bal, problem = problem.replace(format="bal"), problem.replace(format="colmap")
    kept, divided = predict_ranks(problem, inspection, counts=[1, 3])
    bal_kept, bal_divided = predict_ranks(bal, inspection, counts=[1, 3])
    observations = 28 * problem.num_observations
    assert kept.memory_of_first_in_bytes > bal_kept.memory_of_first_in_bytes + observations
    for name, most in (("memory_of_first_in_bytes", 50), ("memory_of_others_in_bytes", 40)):
        per_point = (getattr(divided, name) - getattr(bal_divided, name)) / problem.num_points
        assert 8 <= per_point <= most  # ids, and errors of points; a bit less of another gauge


def test_the_network(problem, inspection):
    (slow,) = predict_ranks(problem, inspection, counts=[4], network=(1, 50))
    (fast,) = predict_ranks(problem, inspection, counts=[4], network=(math.nextafter(1e9, 0), 50))
    (near,) = predict_ranks(problem, inspection, counts=[4], network=(1, 1e-9))
    sent = slow.network_time_per_step_in_seconds
    # Four processes are two levels of a tree, at each of which double-doubles arrive.
    reduced = find_pattern(problem, resolve_defaults(problem, bundle.SolveOptions())).reduced
    only_down = 8 * 3 * reduced.num_columns
    received = 2 * slow.bytes_per_step - only_down
    assert near.network_time_per_step_in_seconds == pytest.approx(8e-9 * received)
    latency = fast.network_time_per_step_in_seconds
    assert sent == pytest.approx(latency + near.network_time_per_step_in_seconds)
    gained = slow.time_per_step_in_seconds - fast.time_per_step_in_seconds
    assert gained == pytest.approx(sent - latency)


@pytest.mark.parametrize(
    "bad",
    [
        {"counts": [0]},
        {"counts": [601]},
        {"counts": [1], "network": (0, 1)},
        {"counts": [1], "network": (1, math.nan)},
    ],
)
def test_refusals(problem, inspection, bad):
    with pytest.raises(bundle.InputError):
        predict_ranks(problem, inspection, **bad)
    assert predict_ranks(problem, inspection, counts=[]) == ()


def test_no_process_can_take_what_only_ceres_does(problem):
    inspection = bundle.inspect(problem, num_threads=1, refine="points")
    with pytest.raises(bundle.InputError, match="Ceres"):
        predict_ranks(problem, inspection, bundle.SolveOptions(refine="points"), counts=[2])
