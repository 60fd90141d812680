import os
import time
from pathlib import Path

import pytest
from benchmarks.problems import BenchmarkProblem

import bundle
from benchmarks import taken_core

needs_two_cores = pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core")


def processor_seconds(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@needs_two_cores
def test_another_process_is_busy_on_the_second_core_until_the_end(monkeypatch):
    started = []
    popen = taken_core.subprocess.Popen
    monkeypatch.setattr(
        taken_core.subprocess, "Popen", lambda command: started.append(popen(command)) or started[0]
    )
    before = os.sched_getaffinity(0)
    with taken_core.two_cores_of_which_one_is_taken():
        (busy,) = started
        assert len(os.sched_getaffinity(0)) == 2
        until = time.monotonic() + 20
        while time.monotonic() < until and processor_seconds(busy.pid) < 0.05:
            time.sleep(0.05)
        assert processor_seconds(busy.pid) >= 0.05
        assert os.sched_getaffinity(busy.pid) == {max(os.sched_getaffinity(0))}
    assert busy.returncode is not None and os.sched_getaffinity(0) == before


@needs_two_cores
def test_solves_take_turns_on_one_and_two_threads(monkeypatch, tmp_path):
    problem = bundle.synthesize(scene="orbit", num_images=6, num_points=60, seed=1).problem
    bundle.save(problem, tmp_path / "model")
    given = BenchmarkProblem("small", "colmap", tmp_path / "model")
    monkeypatch.setattr(taken_core.problems, "find", lambda _: [given])
    solved = []
    solve = taken_core.bundle.solve
    monkeypatch.setattr(
        taken_core.bundle,
        "solve",
        lambda problem, **how: solved.append(how["num_threads"]) or solve(problem, **how),
    )
    found = taken_core.measured(1)
    assert solved == [1, 2] * taken_core.AT_ONCE
    assert {key: len(times) for key, times in found["small"].items()} == {"1": 5, "2": 5}


def test_the_table_judges_the_ratio_of_the_medians():
    table = taken_core.taken_table(
        {
            "good": {"1": [1.0, 9.0, 2.0], "2": [2.1, 2.1, 99.0]},
            "bad": {"1": [2.0, 2.0, 2.0], "2": [2.2, 2.2, 0.1]},
        }
    )
    good, bad = table.splitlines()[-2:]
    assert "1.05" in good and "yes" in good
    assert "1.10" in bad and "no" in bad
