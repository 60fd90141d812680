"""Progress, Ctrl-C, exceptions of callbacks, the GIL."""

import _thread
import functools
import operator
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


@pytest.mark.parametrize("last", [0, 3])
def test_what_a_callback_raises_comes_out(solve, last):
    def fail(record):
        if record["iteration"] == last:
            raise RuntimeError("from the callback")

    with pytest.raises(RuntimeError, match="from the callback"):
        solve(scenes.make_problem(), progress=fail, max_num_iterations=last, **LONG)


def test_ctrl_c_does_not_hide_what_a_callback_raises(solve):
    """Both at once: no bytecode runs between the signal and the exception of adding None."""
    progress = functools.partial(sum, map(operator.call, [_thread.interrupt_main]))
    with pytest.raises(TypeError, match="unsupported operand"):
        solve(scenes.make_problem(), progress=progress, **LONG)


def test_keyboard_interrupt_of_a_callback_is_ctrl_c(solve):
    def stop(record):
        if record["iteration"] == 2:
            raise KeyboardInterrupt

    result = solve(scenes.make_problem(perturbation=0.05), progress=stop, **LONG)
    assert result.summary.interrupted
    assert result.iterations["iteration"].tolist() == [0, 1, 2]


def test_what_a_signal_handler_raises_comes_out(solve):
    def expire(*_):
        raise TimeoutError("too late")

    previous = signal.signal(signal.SIGALRM, expire)
    try:
        with pytest.raises(TimeoutError, match="too late"):
            solve(
                scenes.make_problem(perturbation=0.05),
                progress=lambda _: signal.raise_signal(signal.SIGALRM),
                **LONG,
            )
    finally:
        signal.signal(signal.SIGALRM, previous)


def test_ctrl_c_is_seen_between_two_calls_of_the_callback(solve):
    problem = scenes.make_problem(num_images=30, num_points=2000, track=8, perturbation=0.05)
    timers = []

    def interrupt_soon(record):
        if record["iteration"] == 1:
            timers.append(threading.Timer(1e-3, _thread.interrupt_main))
            timers[0].start()

    summary = solve(problem, progress=interrupt_soon, **LONG).summary
    assert summary.interrupted
    assert summary.termination_type == "USER_SUCCESS"
    timers[0].join()


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
