"""Two threads against one while another process keeps one of two cores busy.

On a loaded machine, the system interrupts a thread in the middle of its work, and the other threads
wait for it. The target: a solve on two threads takes at most 5 % longer than one on one thread. Run
it on an idle machine: other processes would take the other core, too.

Prints a row per real problem: the medians and the ratio of them. Solves take turns.

Run: python -m benchmarks.taken_core [--repeat N] [--json FILE]
"""

from __future__ import annotations

import contextlib
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import bundle
from benchmarks import measure, problems, table

BUSY = "import os, sys\nos.sched_setaffinity(0, {int(sys.argv[1])})\nwhile True:\n    pass"
STEPS = 8
AT_ONCE = 5
"""Solves on one and on two threads per repeat."""
AT_MOST = 1.05

Runs = Mapping[str, Mapping[str, Sequence[float]]]


@contextlib.contextmanager
def two_cores_of_which_one_is_taken() -> Iterator[None]:
    """Keep this process on two cores, and a busy one on the second of these."""
    allowed = os.sched_getaffinity(0)
    cores = sorted(allowed)[:2]
    if len(cores) < 2:
        raise SystemExit(f"error: expected two cores, found {len(cores)}")
    busy = subprocess.Popen([sys.executable, "-c", BUSY, str(cores[1])])
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)
        busy.kill()
        busy.wait()


def solve_time(problem: bundle.Problem, threads: int) -> float:
    """Return seconds of a solve of a few steps."""
    options: dict[str, Any] = {
        **{f"{name}_tolerance": 1e-300 for name in ("function", "gradient", "parameter")},
        **{"num_threads": threads, "max_num_iterations": STEPS},
    }
    start = time.perf_counter()
    bundle.solve(problem, **options)
    return time.perf_counter() - start


def measured(repeat: int) -> dict[str, dict[str, list[float]]]:
    """Return seconds of solves by problem and number of threads."""
    took: dict[str, dict[str, list[float]]] = {}
    with two_cores_of_which_one_is_taken():
        for given in problems.find(problems.data_folder()):
            problem = bundle.load(given.path)
            took[given.name] = {"1": [], "2": []}
            for _ in range(repeat * AT_ONCE):
                for threads, times in took[given.name].items():
                    times.append(solve_time(problem, int(threads)))
    return took


def taken_table(found: Runs) -> str:
    """Return a line per problem: milliseconds of both, their ratio, and whether it is met."""
    lines = []
    for name, runs in found.items():
        one, two = (statistics.median(runs[threads]) for threads in ("1", "2"))
        is_met = "yes" if two <= AT_MOST * one else "no"
        lines.append([name, f"{1e3 * one:.2f}", f"{1e3 * two:.2f}", f"{two / one:.2f}", is_met])
    header = ["problem", "1 thread [ms]", "2 threads [ms]", "ratio", f"at most {AT_MOST}"]
    return table.grid(header, lines)


if __name__ == "__main__":
    measure.run_alone(__doc__, measured, taken_table)
