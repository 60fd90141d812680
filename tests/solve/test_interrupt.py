"""Progress, Ctrl-C, exceptions of callbacks, the GIL."""

import signal
import threading
import time

import numpy as np
import pytest

from tests import scenes

LONG = {"function_tolerance": 0, "gradient_tolerance": 0, "parameter_tolerance": 0}


def test_progress_sees_every_iteration(solve):
    seen = []
    result = solve(scenes.make_problem(), progress=seen.append)
    assert {name: [record[name] for record in seen] for name in seen[0]} == {
        name: array.tolist() for name, array in result.iterations.items()
    }


def test_ctrl_c_keeps_the_best_state(solve):
    def interrupt(record):
        if record["iteration"] == 2:
            signal.raise_signal(signal.SIGINT)

    problem = scenes.make_problem(perturbation=0.05)
    result = solve(problem, progress=interrupt, **LONG)
    assert result.summary.interrupted
    assert result.summary.termination_type == "USER_SUCCESS"
    assert result.summary.is_solution_usable
    assert len(result.iterations["cost"]) in (3, 4)
    assert result.summary.final_cost == result.iterations["cost"].min()
    assert result.reprojection_error_after.rmse == pytest.approx(
        np.sqrt(2 * result.summary.final_cost / problem.num_observations)
    )
    assert not solve(problem).summary.interrupted


def test_what_a_callback_raises_comes_out(solve):
    def fail(_):
        raise RuntimeError("from the callback")

    with pytest.raises(RuntimeError, match="from the callback"):
        solve(scenes.make_problem(), progress=fail)


def test_other_threads_run_while_a_solve_runs(solve):
    problem = scenes.make_problem(num_images=30, num_points=2000, track=8)
    running = threading.Event()
    ticks = []

    def tick():
        while running.is_set():
            ticks.append(time.perf_counter())
            time.sleep(1e-3)

    running.set()
    thread = threading.Thread(target=tick)
    thread.start()
    begin = time.perf_counter()
    solve(problem, num_threads=1, max_num_iterations=20, **LONG)
    end = time.perf_counter()
    running.clear()
    thread.join()
    inside = [t for t in ticks if begin < t < end]
    assert len(inside) > 5


def test_solves_may_overlap(solve):
    problems = [scenes.make_problem(seed=seed) for seed in range(4)]
    expected = [solve(p, num_threads=1).summary.final_cost for p in problems]
    found = [0.0] * len(problems)

    def run(k):
        found[k] = solve(problems[k], num_threads=1).summary.final_cost

    threads = [threading.Thread(target=run, args=(k,)) for k in range(len(problems))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == expected
