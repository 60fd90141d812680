"""Workers that end in every way there is."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

import bundle
from bundle.interface.options import SolveOptions
from bundle.planning.comparison import process
from tests.printed import figures
from tests.scenes import make_problem, scene


@pytest.fixture
def work(tmp_path):
    """Run a worker on a problem."""

    def run(problem=None, *, timeout=30.0, memory_cap=0, on_iteration=lambda _: None, **changes):
        folder = tmp_path / "problem"
        if not folder.exists():
            process.store(problem or scene(), folder)
        request = tmp_path / "request.json"
        options = SolveOptions(num_threads=1, **changes).asdict()
        request.write_text(json.dumps({"options": options, "memory_cap": memory_cap}))
        return process.run_worker(
            folder, request, timeout=timeout, memory_cap=memory_cap, on_iteration=on_iteration
        )

    return run


@pytest.fixture
def instead(monkeypatch):
    """Let workers run a script of the test's, which has the arguments FOLDER REQUEST CHANNEL."""

    def install(script):
        def command(*arguments):
            return [sys.executable, "-c", script, *map(str, arguments)]

        monkeypatch.setattr(process, "worker_command", command)

    return install


def is_running(note):
    """Return whether the process whose id is in a file runs; a zombie does not."""
    try:
        status = Path(f"/proc/{note.read_text()}/status").read_text()
    except FileNotFoundError:
        return False
    return "State:\tZ" not in status


def test_problem_survives_the_way(tmp_path):
    problem = make_problem()
    process.store(problem, tmp_path / "problem")
    for mode in (None, "r"):
        back = process.restore(tmp_path / "problem", mode)
        for name in problem.__dataclass_fields__:
            if name != "source":
                assert (getattr(back, name) == getattr(problem, name)) is not False
                assert str(getattr(back, name)) == str(getattr(problem, name))


def test_worker_measures_what_a_solve_here_gives(work):
    problem = make_problem(num_images=12, num_points=300)
    seen = []
    end = work(problem, linear_solver_type="dense_schur", on_iteration=seen.append)
    here = bundle.solve(problem, linear_solver_type="dense_schur", num_threads=1)
    assert (end.outcome, end.message) == ("done", "")
    assert end.measurement["summary"]["final_cost"] == here.summary.final_cost
    assert end.measurement["iterations"]["cost"] == here.iterations["cost"].tolist()
    assert end.measurement["peak_memory_in_bytes"] > 20e6
    assert 0 <= end.measurement["added_memory_in_bytes"] < end.measurement["peak_memory_in_bytes"]


def test_refusal_has_the_words_of_the_error(work):
    end = work(backend="fused", linear_solver_type="dense_qr")
    assert end.outcome == "refused"
    assert end.message.startswith("linear_solver_type: ")


def test_time_out_keeps_the_iterations_so_far(work):
    problem = make_problem(num_images=6, num_points=500)
    seen = []
    started = time.monotonic()
    end = work(
        problem,
        backend="ceres",
        linear_solver_type="dense_qr",  # some 2e10 flops a step
        function_tolerance=0.0,
        gradient_tolerance=0.0,
        parameter_tolerance=0.0,
        max_num_iterations=10**6,
        timeout=3.0,
        on_iteration=seen.append,
    )
    assert time.monotonic() - started < 20
    assert end.outcome == "timed_out"
    latest = end.iterations[-1]
    assert figures(end.message) == ["3", str(latest["iteration"]), f"{latest['cost']:.4e}"]
    assert end.measurement is None
    assert end.iterations[0]["iteration"] == 0
    assert end.iterations[-1] == seen[-1]


def test_time_out_ends_all_that_a_worker_started(work, instead, tmp_path):
    note = tmp_path / "pid"
    instead(
        "import subprocess, sys, time; child = subprocess.Popen(['sleep', '60']); "
        f"open({str(note)!r}, 'w').write(str(child.pid)); time.sleep(60)"
    )
    end = work(timeout=1.0)
    assert end.outcome == "timed_out"
    assert "1 s" in end.message
    deadline = time.monotonic() + 5
    while is_running(note) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not is_running(note)


@pytest.mark.parametrize(
    ("script", "outcome", "words"),
    [
        ("import os; os.kill(os.getpid(), 9)", "died", "memory"),
        ("import os; os.kill(os.getpid(), 11)", "died", "SIGSEGV"),
        ("raise SystemExit('what a day')", "died", "exit code 1: what a day"),
        ("pass", "died", "exit code 0"),
        (
            "import os, sys; print('CHOLMOD error: out of memory', flush=True); os.abort()",
            "out_of_memory",
            "SIGABRT",
        ),
    ],
)
def test_death_is_told(work, instead, script, outcome, words):
    instead(script)
    end = work()
    assert end.outcome == outcome
    assert words in end.message
    assert end.measurement is None


def test_growth_beyond_the_cap_is_ended_at_once(work, instead):
    instead(
        "import os, sys, time\n"
        "from bundle.planning.comparison import process\n"
        "channel = os.fdopen(int(sys.argv[3]), 'w')\n"
        "print('{\"resident\": %d}' % process.resident_memory(), file=channel, flush=True)\n"
        "hoard = b'x' * 200_000_000\n"
        "time.sleep(60)\n"
    )
    started = time.monotonic()
    end = work(memory_cap=100_000_000)
    assert end.outcome == "out_of_memory"
    assert "100 MB" in end.message
    assert time.monotonic() - started < 20


def test_interrupt_ends_the_worker(work, instead, tmp_path):
    note = tmp_path / "pid"
    instead(
        f"import os, sys, time; open({str(note)!r}, 'w').write(str(os.getpid()))\n"
        "channel = os.fdopen(int(sys.argv[3]), 'w')\n"
        'print(\'{"iterations": [{"iteration": 0}]}\', file=channel, flush=True)\n'
        "time.sleep(60)\n"
    )

    def interrupt(_):
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        work(on_iteration=interrupt)
    assert not is_running(note)


@pytest.mark.parametrize("constructor", ["fdopen", "TemporaryFile", "Popen"])
def test_interrupt_in_a_constructor_leaves_nothing_open(work, monkeypatch, constructor):
    module = {"fdopen": os, "TemporaryFile": tempfile, "Popen": subprocess}[constructor]
    construct = getattr(module, constructor)
    made = []

    def interrupted(*arguments, **settings):
        made.append(construct(*arguments, **settings))
        signal.raise_signal(signal.SIGINT)
        return made[0]

    monkeypatch.setattr(module, constructor, interrupted)
    before = set(Path("/proc/self/fd").iterdir())
    with pytest.raises(KeyboardInterrupt):
        work()
    assert set(Path("/proc/self/fd").iterdir()) == before
    assert constructor != "Popen" or made[0].returncode == -signal.SIGKILL
