"""Threads of OpenBLAS in a process, and the environment that they leave."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

NUMBERS = ("OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OMP_NUM_THREADS")
SLEEPS = ("OPENBLAS_THREAD_TIMEOUT", "GOTO_THREAD_TIMEOUT")
PROGRAM = """
import json, os, subprocess, sys
TASKS = "/proc/self/task"
CHILD = "import json, os; print(json.dumps(dict(os.environ)))"
names = sys.argv.pop(1).split(",")
seen, tasks = {}, {}
state = lambda: {name: os.environ[name] for name in names if name in os.environ}
class Note:
    def find_spec(self, name, path=None, target=None):
        if name in ("bundle._core", "numpy", "bundle.cli.declarations"):
            seen[name] = state()
            tasks[name] = len(os.listdir(TASKS)) if os.path.isdir(TASKS) else 0
sys.meta_path.insert(0, Note())
START
try:
    run()
except SystemExit:
    pass
child = json.loads(subprocess.check_output([sys.executable, "-c", CHILD]))
seen["child"] = {name: child[name] for name in names if name in child}
sys.stderr.write(json.dumps([seen, tasks]))
"""
OURS = "from bundle.__main__ import run"
LIBRARY = "def run():\n    import bundle; bundle.solve"
NUMPY_FIRST = f"import numpy\n{LIBRARY}"
OTHERS = "from bundle.cli.main import main as run"


def loaded(start: str = OURS, **given: str) -> tuple[dict[str, dict[str, str]], dict[str, int]]:
    """Return the variables while modules are loaded and later, and the number of threads."""
    names = (*NUMBERS, *SLEEPS)
    env = {name: value for name, value in os.environ.items() if name not in names} | given
    code = PROGRAM.replace("START", start)
    command = [sys.executable, "-c", code, ",".join(names), "refine", "--help"]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    seen, tasks = json.loads(done.stderr)
    return seen, tasks


def test_idle_threads_sleep_and_numpy_has_one_thread():
    seen, tasks = loaded()
    assert seen["bundle._core"] == {"OPENBLAS_THREAD_TIMEOUT": "20"}
    assert seen["numpy"] == {"OPENBLAS_THREAD_TIMEOUT": "20", "OPENBLAS_NUM_THREADS": "1"}
    assert seen["bundle.cli.declarations"] == seen["child"] == {}
    assert tasks["bundle.cli.declarations"] == tasks["numpy"]


@pytest.mark.parametrize("name", NUMBERS)
def test_a_number_of_the_user_stays(name):
    seen, tasks = loaded(**{name: "2"})
    assert seen["numpy"] == {"OPENBLAS_THREAD_TIMEOUT": "20", name: "2"}
    assert seen["bundle.cli.declarations"] == seen["child"] == {name: "2"}
    if Path("/proc/self/task").is_dir():
        assert tasks["bundle.cli.declarations"] - tasks["numpy"] == min(os.cpu_count() or 1, 2) - 1


@pytest.mark.parametrize("name", SLEEPS)
def test_a_time_of_the_user_stays(name):
    seen, _ = loaded(**{name: "24"})
    assert seen["bundle._core"] == seen["child"] == {name: "24"}
    assert seen["numpy"] == {name: "24", "OPENBLAS_NUM_THREADS": "1"}


@pytest.mark.parametrize("value", ["", "0"])
def test_a_variable_without_a_number_is_restored(value):
    seen, _ = loaded(OPENBLAS_NUM_THREADS=value)
    assert seen["numpy"]["OPENBLAS_NUM_THREADS"] == "1"
    assert seen["child"] == {"OPENBLAS_NUM_THREADS": value}


def test_another_program_keeps_its_own_threads():
    seen, _ = loaded(OTHERS)
    assert seen["numpy"] == seen["bundle._core"] == seen["child"] == {}


def test_idle_threads_of_a_script_sleep_and_keep_their_number():
    seen, _ = loaded(LIBRARY)
    assert seen["numpy"] == seen["bundle._core"] == {"OPENBLAS_THREAD_TIMEOUT": "20"}
    assert seen["child"] == {}


def test_a_library_that_the_script_loaded_keeps_its_own():
    seen, _ = loaded(NUMPY_FIRST)
    assert seen["numpy"] == seen["child"] == {}
    assert seen["bundle._core"] == {"OPENBLAS_THREAD_TIMEOUT": "20"}


@pytest.mark.parametrize("name", SLEEPS)
def test_a_time_of_the_user_stays_in_a_script(name):
    seen, _ = loaded(LIBRARY, **{name: "24"})
    assert seen["numpy"] == seen["bundle._core"] == seen["child"] == {name: "24"}


def test_names_that_need_no_library_load_none():
    seen, _ = loaded("def run():\n    import bundle; bundle.InputError, bundle.get_include()")
    assert "numpy" not in seen
