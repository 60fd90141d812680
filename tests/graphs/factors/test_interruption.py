"""Solves of factor graphs: progress, Ctrl-C, exceptions, the GIL, threads."""

import itertools
import os
import signal
import threading
import time

import numpy as np
import pytest

import bundle

LONG = {"function_tolerance": 0, "gradient_tolerance": 0, "parameter_tolerance": 0}


def helix(count=200, seed=0):
    """A chain of poses with closures, far from its optimum."""
    rng = np.random.default_rng(seed)
    graph = bundle.FactorGraph()
    for i in range(count):
        graph.add_variable(i, [i, 0, 0] + 0.3 * rng.standard_normal(3), "se2", fixed=i == 0)
    for step in (1, 7):
        for i in range(count - step):
            turn = 0.1 * step
            measured = [step, 0, turn] + 0.02 * rng.standard_normal(3)
            graph.add_factor(bundle.BetweenFactor(i, i + step, measured, 100.0))
    return graph


class Valley:
    """Rosenbrock's, from Python; `at` is called with the number of each call."""

    def __init__(self, at=lambda _: None):
        self.at, self.calls = at, 0

    def __call__(self, values):
        self.calls += 1
        self.at(self.calls)
        x, y = values[0]
        return [10 * (y - x * x), 1 - x], [[[-20 * x, 10], [-1, 0]]]

    def graph(self):
        graph = bundle.FactorGraph()
        graph.add_variable("x", [-1.2, 1.0])
        graph.add_factor(bundle.FunctionFactor(["x"], self))
        return graph


def send_ctrl_c():
    os.kill(os.getpid(), signal.SIGINT)


def check_best_state(graph, result):
    """The values are those of the best iteration: their cost is the result's, below the start's."""
    assert result.summary.interrupted
    assert result.summary.termination_type == "USER_SUCCESS"
    assert result.summary.is_solution_usable
    assert result.summary.final_cost == result.iterations["cost"].min()
    assert result.summary.final_cost < result.summary.initial_cost
    kept = graph.with_values(result.values).cost()
    assert kept == pytest.approx(result.summary.final_cost, rel=1e-12)


def test_progress_sees_every_iteration():
    seen = []
    result = helix(20).solve(progress=seen.append)
    assert {name: [record[name] for record in seen] for name in seen[0]} == {
        name: array.tolist() for name, array in result.iterations.items()
    }


@pytest.mark.parametrize("own", [False, True])
def test_ctrl_c_in_the_callback_ends_the_solve_at_the_next_iteration(own):
    last = 6 if own else 2

    def interrupt(record):
        if record["iteration"] == last:
            send_ctrl_c()

    graph = Valley().graph() if own else helix()
    result = graph.solve(progress=interrupt, **LONG)
    check_best_state(graph, result)
    assert len(result.iterations["cost"]) in (last + 1, last + 2)
    assert not graph.solve().summary.interrupted


@pytest.mark.parametrize("call", range(9, 15))
def test_ctrl_c_while_a_function_runs_keeps_the_best_state(call):
    valley = Valley(at=lambda n: send_ctrl_c() if n == call else None)
    graph = valley.graph()
    result = graph.solve(**LONG)
    assert valley.calls == call
    check_best_state(graph, result)


def test_ctrl_c_from_a_thread_ends_a_solve_without_callback():
    """The function tells when the solve has begun, and would have it go on for ever."""
    begun = threading.Event()

    def at(call):
        if call == 8:
            begun.set()
        if call > 8:
            time.sleep(0.01)

    def interrupt():
        begun.wait()
        send_ctrl_c()

    thread = threading.Thread(target=interrupt)
    thread.start()
    graph = Valley(at).graph()
    result = graph.solve(max_num_iterations=1000, **LONG)
    thread.join()
    check_best_state(graph, result)


def test_ctrl_c_between_two_calls_of_the_callback():
    graph = helix(1000)
    timers = []

    def interrupt_soon(record):
        if record["iteration"] == 1:
            timers.append(threading.Timer(1e-3, send_ctrl_c))
            timers[0].start()

    result = graph.solve(progress=interrupt_soon, **LONG)
    timers[0].join()
    check_best_state(graph, result)


@pytest.mark.parametrize("call", [1, 2])
def test_ctrl_c_before_the_start_was_evaluated_leaves_nothing_to_keep(call):
    valley = Valley(at=lambda n: send_ctrl_c() if n == call else None)
    with pytest.raises(KeyboardInterrupt):
        valley.graph().solve()


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("last", [0, 3])
def test_what_a_callback_raises_comes_out(own, last):
    def fail(record):
        if record["iteration"] == last:
            raise RuntimeError("from the callback")

    graph = Valley().graph() if own else helix(20)
    with pytest.raises(RuntimeError, match="from the callback"):
        graph.solve(progress=fail, max_num_iterations=last, **LONG)


@pytest.mark.parametrize("own", [False, True])
def test_what_a_signal_handler_raises_comes_out(own):
    def expire(*_):
        raise TimeoutError("too late")

    def alarm(_):
        os.kill(os.getpid(), signal.SIGALRM)

    previous = signal.signal(signal.SIGALRM, expire)
    try:
        graph = Valley().graph() if own else helix(20)
        with pytest.raises(TimeoutError, match="too late"):
            graph.solve(progress=alarm, **LONG)
        if own:
            with pytest.raises(TimeoutError, match="too late"):
                Valley(at=lambda n: alarm(n) if n == 7 else None).graph().solve(**LONG)
    finally:
        signal.signal(signal.SIGALRM, previous)


@pytest.mark.parametrize("error", [SystemExit, GeneratorExit, MemoryError, StopIteration])
def test_a_function_may_raise_anything(error):
    def fail(call):
        if call == 5:
            raise error

    with pytest.raises(error):
        Valley(fail).graph().solve(**LONG)


def test_of_a_function_and_a_callback_that_raise_the_first_comes_out():
    def fail(call):
        if call == 7:
            raise ZeroDivisionError

    def late(record):
        if record["iteration"] >= 1:
            raise RuntimeError

    with pytest.raises((ZeroDivisionError, RuntimeError)):
        Valley(fail).graph().solve(progress=late, **LONG)


def test_other_threads_run_while_a_solve_runs():
    graph = helix(1000)
    running = threading.Event()
    ticks = []

    def tick():
        while running.is_set():
            ticks.append(time.perf_counter())
            time.sleep(1e-3)

    running.set()
    thread = threading.Thread(target=tick)
    thread.start()
    spans = []

    def span(_):
        spans.append(time.perf_counter())

    graph.solve(num_threads=1, max_num_iterations=20, progress=span, **LONG)
    running.clear()
    thread.join()
    # Within iterations: from a call of the callback to the next, where only C++ runs.
    ticking = sum(
        any(begin + 2e-4 < t < end - 2e-4 for t in ticks)
        for begin, end in itertools.pairwise(spans)
    )
    assert ticking >= 1


@pytest.mark.parametrize("own", [False, True])
def test_threads_solve_one_graph_at_the_same_time(own):
    graph = Valley().graph() if own else helix(60)
    expected = graph.solve(num_threads=1)
    results = [None] * 6

    def work(i):
        results[i] = graph.solve(num_threads=1 + i % 3)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for result in results:
        assert result.summary.final_cost == pytest.approx(expected.summary.final_cost, rel=1e-9)
        for key, value in expected.values.items():
            np.testing.assert_allclose(result.values[key], value, rtol=1e-6, atol=1e-9)


def test_a_graph_that_grows_while_it_is_solved():
    graph = helix(20)

    def grow(record):
        graph.add_variable(("new", record["iteration"]), [0.0])

    result = graph.solve(progress=grow)
    assert set(result.values) == set(range(20))
    assert len(graph.keys) == 20 + len(result.iterations["cost"])


def test_functions_run_with_several_threads_asked_for():
    """One at a time, in the thread that solves: it holds the GIL when it calls them."""
    inside = []
    threads = set()

    class Watched(Valley):
        def __call__(self, values):
            assert not inside
            inside.append(None)
            threads.add(threading.get_ident())
            answer = super().__call__(values)
            inside.pop()
            return answer

    graph = bundle.FactorGraph()
    valleys = [Watched() for _ in range(5)]
    for i, valley in enumerate(valleys):
        graph.add_variable(i, [-1.2 - 0.1 * i, 1.0])
        graph.add_factor(bundle.FunctionFactor([i], valley))
    result = graph.solve(num_threads=4, **LONG)
    assert threads == {threading.get_ident()}
    for i in range(5):
        np.testing.assert_allclose(result.values[i], 1, atol=1e-6)
