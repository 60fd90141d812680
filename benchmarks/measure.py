"""Running one child process, and the arithmetic on what repeated runs gave."""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Every library that has its own idea of how many threads it may start.
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Child:
    """Outcome of a process: ``failure`` is "" or one line; seconds and bytes otherwise."""

    failure: str
    wall: float
    cpu: float
    peak_memory: int


def environment(root: Path, threads: int | None) -> dict[str, str]:
    """Return the environment of every child: same threads, ``benchmarks`` importable.

    Without a number of threads, no variable names one, as in the shell of most users.
    Modules keep their bytecode, as those of an installed package do: pip compiles pycolmap's, and
    would compile ours.
    """
    paths = [str(root), os.environ.get("PYTHONPATH", "")]
    without = ("PYTHONDONTWRITEBYTECODE", *_THREAD_VARIABLES)
    inherited = {k: v for k, v in os.environ.items() if k not in without}
    return {
        **inherited,
        **({} if threads is None else {name: str(threads) for name in _THREAD_VARIABLES}),
        "PYTHONPATH": os.pathsep.join(path for path in paths if path),
    }


def physical_memory() -> int:
    """Return the memory of this machine in bytes."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def run_child(command: Sequence[str], env: dict[str, str], timeout: float) -> Child:
    """Run a command silently; after ``timeout`` seconds kill it and all that it has started.

    The peak memory is the kernel's ru_maxrss, which cannot be below this process' own size at the
    fork: the caller keeps small.
    """
    with tempfile.TemporaryFile() as errors:
        start = time.perf_counter()
        process = subprocess.Popen(
            command, env=env, stdout=subprocess.DEVNULL, stderr=errors, process_group=0
        )
        timer = threading.Timer(timeout, os.killpg, (process.pid, signal.SIGKILL))
        timer.start()
        try:
            _, status, usage = os.wait4(process.pid, 0)
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise
        finally:
            timer.cancel()
        wall = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        errors.seek(0)
        last_words = errors.read().decode(errors="replace").strip().splitlines()
    failure = ""
    if process.returncode == -signal.SIGKILL and wall >= timeout:
        failure = f"stopped after the time limit of {timeout:g} s"
    elif process.returncode:
        failure = f"exit {process.returncode}: {last_words[-1] if last_words else 'no message'}"
    unit = 1 if sys.platform == "darwin" else 1024
    return Child(failure, wall, usage.ru_utime + usage.ru_stime, unit * usage.ru_maxrss)


def run_module(
    module: str, arguments: Sequence[str], env: dict[str, str], timeout: float
) -> Any | None:
    """Return what ``python -m module ... --json FILE`` writes; None, and a line, if it fails."""
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        command = [sys.executable, "-m", module, *arguments, "--json", str(answer)]
        child = run_child(command, env, timeout)
        if child.failure:
            print(f"{module}: not measured: {child.failure}", file=sys.stderr)
            return None
        return json.loads(answer.read_text())


def answer(found: Any, table: str, path: Path | None) -> None:
    """Print a table, and write what it was made of where :func:`run_module` reads it."""
    if path is not None:
        path.write_text(json.dumps(found))
    print(table)


def run_alone(doc: str, measured: Callable[[int], Any], table: Callable[[Any], str]) -> None:
    """Be the ``main`` of a module that :func:`run_module` runs: --repeat and --json."""
    parser = argparse.ArgumentParser(description=doc.partition("\n")[0])
    parser.add_argument("--repeat", type=int, default=5, help="runs of each (default 5)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all runs there")
    given = parser.parse_args()
    found = measured(given.repeat)
    answer(found, table(found), given.json)


@dataclass(frozen=True)
class Spread:
    """The median of repeated measurements with the smallest and the largest."""

    median: float
    low: float
    high: float

    @staticmethod
    def of(values: Iterable[float | None]) -> Spread | None:
        """Return the spread, or None if there is no value or one of them is missing."""
        known = list(values)
        numbers = [value for value in known if value is not None]
        if not numbers or len(numbers) < len(known):
            return None
        return Spread(statistics.median(numbers), min(numbers), max(numbers))


def slope(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Return the exponent p of the least-squares fit values ~ c sizes^p, i.e. on log-log axes.

    Raises:
        ValueError: fewer than two sizes that differ.
    """
    if len(set(sizes)) < 2:
        raise ValueError(f"a slope needs two sizes, found {len(set(sizes))}")
    return statistics.linear_regression(
        [math.log(size) for size in sizes], [math.log(value) for value in values]
    ).slope


def time_to_cost(trace: Iterable[Sequence[float]], target: float) -> float | None:
    """Return the time of the first iteration with cost <= target; None if there is none.

    Times between iterations are not interpolated: a cost is reached when it has been computed.
    """
    return next((seconds for seconds, cost in trace if cost <= target), None)
