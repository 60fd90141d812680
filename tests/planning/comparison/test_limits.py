"""Limits of a run: when its clock starts, what its memory counts, what is not repeated."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest

from bundle.interface.options import SolveOptions
from bundle.planning.comparison import process
from bundle.planning.comparison import work as under_way
from bundle.planning.comparison.process import WorkerEnd, _listen, _take
from bundle.planning.comparison.work import Work
from tests.planning.comparison.fakes import DENSE, SPARSE
from tests.reports.terminal import fakes
from tests.scenes import make_problem, scene

MIB = 2**20
SPACE = {"VmData": 1000 * MIB}


def measured(**changes):
    """A measurement as a worker sends it."""
    return {"solve_time_in_seconds": 1.0, "added_memory_in_bytes": 100, **changes}


def listen(monkeypatch, script, *, timeout, memory_cap=0):
    """Run the parent's loop against a clock and a channel that the test drives.

    The script is a list of (time, message to send then or None), one a look at the clock.
    """
    reader, writer = os.pipe()
    steps = iter(script)

    def monotonic():
        time, message = next(steps)
        if message is not None:
            os.write(writer, json.dumps(message).encode() + b"\n")
        return time

    monkeypatch.setattr(process, "time", SimpleNamespace(monotonic=monotonic))
    monkeypatch.setattr(process, "SECONDS_BETWEEN_LOOKS", 0.001)
    try:
        with os.fdopen(reader, "rb", buffering=0) as channel:
            alive = SimpleNamespace(pid=os.getpid())
            return _listen(alive, channel, timeout, memory_cap, lambda _: None)
    finally:
        os.close(writer)


def test_the_time_out_counts_from_the_loaded_problem(monkeypatch):
    loaded = {"resident": 1}
    # Start; look; loaded at 9, so that the end is at 19; look at 18; look at 19.
    script = [(0, None), (9, loaded), (9, None), (18, None), (19, {"refused": "why"}), (19, None)]
    assert listen(monkeypatch, script, timeout=10).outcome == "refused"
    script = [(0, None), (9, loaded), (9, None), (18, None), (19.1, None)]
    assert listen(monkeypatch, script, timeout=10).outcome == "timed_out"


def test_loading_may_not_take_for_ever_either(monkeypatch):
    script = [(0, None), (9, None), (10, None), (10.1, None)]
    assert listen(monkeypatch, script, timeout=10).outcome == "timed_out"


@pytest.mark.parametrize(
    ("cap", "added", "outcome"),
    [(100, 101, "out_of_memory"), (100, 100, "done"), (100, -1, "done"), (0, 10**12, "done")],
)
def test_a_peak_beyond_the_cap_is_no_result(cap, added, outcome):
    end = WorkerEnd()
    _take(end, {"measurement": measured(added_memory_in_bytes=added)}, cap)
    assert end.outcome == outcome
    assert (end.measurement is None) == (outcome == "out_of_memory")


@pytest.fixture
def solved(monkeypatch, tmp_path):
    """Run the worker's solve here, on memory as the test says; return (report, limits set)."""

    def run(*, load_peak, resident, peak, knows_growth=True, cap=0):
        peaks, limits = iter([load_peak, peak]), []
        for name, value in {
            "peak_memory": lambda: next(peaks),
            "resident_memory": lambda: resident,
            "restart_peak": lambda: knows_growth,
            "limit_growth": lambda *arguments: limits.append(arguments),
        }.items():
            monkeypatch.setattr(process, name, value)
        monkeypatch.setattr(process, "restore", lambda _: scene())
        channel = (tmp_path / "channel").open("w")
        options = SolveOptions(num_threads=1, max_num_iterations=1)
        with channel:
            report = process._run(tmp_path, options, {"memory_cap": cap}, process.Reporter(channel))
        first = json.loads((tmp_path / "channel").read_text().splitlines()[0])
        assert first == {"resident": resident}
        return report["measurement"], limits

    return run


@pytest.mark.parametrize(
    ("load_peak", "peak", "knows_growth", "largest", "added"),
    [
        (900, 700, True, 900, 200),
        (600, 700, True, 700, 200),
        (900, 400, True, 900, 0),  # memory was given back
        (900, 700, False, 900, -1),
    ],
)
def test_what_a_solve_adds(solved, load_peak, peak, knows_growth, largest, added):
    found, limits = solved(load_peak=load_peak, resident=500, peak=peak, knows_growth=knows_growth)
    assert (found["peak_memory_in_bytes"], found["added_memory_in_bytes"]) == (largest, added)
    assert limits == []


def test_a_cap_limits_the_worker_itself_for_its_threads(solved):
    _, limits = solved(load_peak=1, resident=1, peak=1, cap=12_345)
    assert limits == [(12_345, 1)]


@pytest.mark.parametrize(
    ("threads", "cores", "stack", "reserved"),
    [
        # Stacks and buffers of OpenBLAS of each core or thread and of the caller, and the arenas.
        (1, 2, 8 * MIB, 3 * (8 + 128) + 64),
        (6, 2, 8 * MIB, 7 * (8 + 128) + 64),
        (1, 4, 16 * MIB, 5 * (16 + 128) + 64),
        (1, 2, resource.RLIM_INFINITY, 3 * (8 + 128) + 64),
    ],
)
@pytest.mark.parametrize("hard", [resource.RLIM_INFINITY, 2**45, 1500 * MIB])
def test_what_threads_only_set_aside_is_beyond_the_cap(
    monkeypatch, threads, cores, stack, reserved, hard
):
    limits = {resource.RLIMIT_STACK: (stack, stack), resource.RLIMIT_DATA: (hard, hard)}
    applied = []
    monkeypatch.setattr(process.resource, "getrlimit", limits.__getitem__)
    monkeypatch.setattr(process.resource, "setrlimit", lambda *given: applied.append(given))
    monkeypatch.setattr(process.os, "cpu_count", lambda: cores)
    monkeypatch.setattr(process, "_kibibytes", lambda _, field: SPACE[field])
    process.limit_growth(300 * MIB, threads)
    limit = (1000 + 300 + reserved) * MIB
    # A limit that is lower already stays.
    assert applied == ([] if limit >= hard > 0 else [(resource.RLIMIT_DATA, (limit, limit))])


def test_where_the_system_tells_nothing_there_is_no_limit(monkeypatch):
    applied = []
    monkeypatch.setattr(process.resource, "setrlimit", lambda *given: applied.append(given))
    monkeypatch.setattr(process, "_kibibytes", lambda *_: 0)
    process.limit_growth(1, 1)
    assert applied == []


def test_growth_beyond_the_limit_fails_and_below_it_does_not():
    code = (
        "from bundle.planning.comparison import process; import mmap\n"
        "process.limit_growth(50 << 20, 1)\n"
        "below = mmap.mmap(-1, 40 << 20, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)\n"
        "try: mmap.mmap(-1, 64 << 30, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)\n"
        "except OSError: print('refused')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "refused\n"


def test_a_worker_goes_first_when_memory_ends(tmp_path, monkeypatch):
    """The kernel's score of the real process, read while it runs; its cores are not kept either."""
    process.store(make_problem(num_images=6, num_points=500), tmp_path / "problem")
    options = SolveOptions(
        num_threads=1,
        backend="ceres",
        linear_solver_type="dense_qr",  # some 2e10 flops a step: there is time to look
        function_tolerance=0.0,
    )
    request = tmp_path / "request.json"
    request.write_text(json.dumps({"options": options.asdict(), "memory_cap": 0}))
    started, scores = [], []
    original = subprocess.Popen

    def popen(*arguments, **settings):
        started.append(original(*arguments, **settings))
        return started[-1]

    def look(_):
        if not scores:
            status = Path(f"/proc/{started[0].pid}")
            scores.append(int((status / "oom_score_adj").read_text()))
            cores = next(
                line for line in (status / "limits").read_text().splitlines() if "core" in line
            )
            assert cores.split()[-3:-1] == ["0", "0"]
            started[0].kill()

    monkeypatch.setattr(subprocess, "Popen", popen)
    process.run_worker(tmp_path / "problem", request, timeout=30.0, memory_cap=0, on_iteration=look)
    assert scores == [1000]


@pytest.fixture
def rounds(monkeypatch, tmp_path):
    """Run two methods up to three times, each end as the test says; return how often each ran."""

    def run(end_of):
        calls = {DENSE: 0, SPARSE: 0}

        def run_worker(_folder, request, **_):
            solver = json.loads(request.read_text())["options"]["linear_solver_type"]
            method = DENSE if solver == "dense_schur" else SPARSE
            calls[method] += 1
            return end_of(method)

        monkeypatch.setattr(under_way, "run_worker", run_worker)
        monkeypatch.setattr(under_way, "predict", lambda *_: {})
        made = Work(
            folder=tmp_path, options=fakes.OPTIONS, methods=(DENSE, SPARSE), repeat=3,
            timeout=60.0, memory_cap=0, report=lambda _: None,
        )  # fmt: skip
        problem = made.take_over(0, scene())
        assert made.run_all([problem]) is False
        return calls[DENSE], calls[SPARSE]

    return run


@pytest.mark.parametrize(("seconds", "times"), [(9.99, 3), (10.0, 3), (10.01, 1)])
def test_what_takes_over_ten_seconds_is_not_repeated(rounds, seconds, times):
    def end_of(method):
        time = seconds if method == DENSE else 1.0
        return WorkerEnd(outcome="done", measurement=measured(solve_time_in_seconds=time))

    assert rounds(end_of) == (times, 3)


def test_one_slow_repeat_settles_it(rounds):
    times = count(1)

    def end_of(method):
        slow = method == DENSE and next(times) == 2
        return WorkerEnd(
            outcome="done", measurement=measured(solve_time_in_seconds=11.0 if slow else 1.0)
        )

    assert rounds(end_of) == (2, 3)


def test_what_failed_is_not_repeated(rounds):
    def end_of(method):
        if method == DENSE:
            return WorkerEnd(outcome="died", message="why")
        return WorkerEnd(outcome="done", measurement=measured())

    assert rounds(end_of) == (1, 3)
