from __future__ import annotations

import os
import sys
import time

import pytest
from benchmarks.measure import Spread, environment, run_child, slope, time_to_cost

TRACE = [(0.1, 100.0), (0.2, 10.0), (0.3, 50.0), (0.4, 9.0)]


@pytest.mark.parametrize(
    ("target", "expected"), [(200.0, 0.1), (10.0, 0.2), (9.5, 0.4), (9.0, 0.4), (8.9, None)]
)
def test_time_to_cost_is_that_of_the_first_iteration_there(target, expected):
    assert time_to_cost(TRACE, target) == expected


def test_an_empty_trace_reaches_nothing():
    assert time_to_cost([], 1e9) is None


def test_spread_is_median_and_extremes():
    assert Spread.of([3.0, 1.0, 10.0]) == Spread(3.0, 1.0, 10.0)
    assert Spread.of([1.0, 2.0]) == Spread(1.5, 1.0, 2.0)


@pytest.mark.parametrize("values", [[], [1.0, None], [None]])
def test_spread_needs_every_value(values):
    assert Spread.of(values) is None


@pytest.mark.parametrize("power", [0.5, 1.0, 1.7])
def test_the_slope_is_the_power_of_growth(power):
    sizes = [5e4, 2e5, 1e6, 5e6]
    factors = [1.1, 1 / 1.1, 1 / 1.1, 1.1]  # nearly without effect on a line through four points
    values = [3e-5 * n**power * factor for n, factor in zip(sizes, factors, strict=True)]
    assert slope(sizes, values) == pytest.approx(power, abs=0.01)
    with pytest.raises(ValueError, match="two sizes"):
        slope([5.0, 5.0], [1.0, 2.0])


def _child(code, timeout=30.0, **env):
    return run_child([sys.executable, "-c", code], {**os.environ, **env}, timeout)


def test_a_child_is_measured():
    child = _child("data = bytearray(150_000_000)\nfor i in range(0, len(data), 4096): data[i] = 1")
    assert child.failure == ""
    assert child.peak_memory > 150e6
    assert child.cpu > 0.0
    assert 0.0 < child.wall < 30.0


def test_a_child_that_takes_too_long_is_stopped():
    child = _child("import time; time.sleep(60)", timeout=0.3)
    assert child.failure == "stopped after the time limit of 0.3 s"
    assert child.wall < 30.0


def test_what_a_stopped_child_has_started_is_stopped_too(tmp_path):
    proof = tmp_path / "alive"
    grandchild = f"import time; time.sleep(2.5); open({str(proof)!r}, 'w')"
    child = _child(
        f"import subprocess, sys; subprocess.run([sys.executable, '-c', {grandchild!r}])",
        timeout=1.0,
    )
    assert child.failure == "stopped after the time limit of 1 s"
    time.sleep(2.5)
    assert not proof.exists()


def test_a_child_that_fails_gives_its_last_words():
    assert _child("import sys; sys.exit('no such luck')").failure == "exit 1: no such luck"


def test_a_child_that_is_killed_has_not_run_out_of_time():
    child = _child("import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    assert child.failure == "exit -9: no message"


def test_every_library_gets_the_same_threads(tmp_path):
    env = environment(tmp_path, 3)
    assert {env[f"{name}_NUM_THREADS"] for name in ("OMP", "OPENBLAS", "MKL")} == {"3"}
    assert env["PYTHONPATH"].split(os.pathsep)[0] == str(tmp_path)


def test_a_whole_process_chooses_its_own_threads(tmp_path, monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    assert not [name for name in environment(tmp_path, None) if name.endswith("_NUM_THREADS")]
