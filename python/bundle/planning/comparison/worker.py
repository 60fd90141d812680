"""Worker of one run: ``python -m bundle.planning.comparison.worker FOLDER REQUEST CHANNEL``.

FOLDER contains the problem (see ``hand_over``). REQUEST is a JSON file of options and limits. It
may have two paths: "start" has the values to start from, "solution" receives the result.
CHANNEL is the number of an open file that receives one JSON object per line:

- ``{"resident": bytes}`` once the problem is loaded,
- ``{"iterations": [...]}`` regularly, by the names of Ceres' IterationSummary,
- one of ``{"measurement": {...}}``, ``{"refused": why}`` and ``{"out_of_memory": true}``.

Libraries may print to standard output and error.
"""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import sys
import time
from pathlib import Path
from typing import Any, TextIO

import bundle._core as _core
from bundle.errors import InputError
from bundle.interface.environment import load_average
from bundle.interface.options import SolveOptions
from bundle.planning.comparison import process_memory
from bundle.planning.comparison.hand_over import restore, restore_solution, store_solution
from bundle.solving.result import Result
from bundle.solving.solve import solve

SECONDS_BETWEEN_REPORTS = 0.1


class Reporter:
    """Sender of iterations in batches, because a step may take less time than a message."""

    def __init__(self, channel: TextIO) -> None:
        self._channel = channel
        self._waiting: list[dict[str, Any]] = []
        self._sent = time.perf_counter()

    def iteration(self, values: dict[str, Any]) -> None:
        """Queue an iteration; send the queue if enough time has passed since the last batch."""
        self._waiting.append(values)
        if time.perf_counter() - self._sent >= SECONDS_BETWEEN_REPORTS:
            self.send({"iterations": self._waiting})
            self._waiting = []
            self._sent = time.perf_counter()

    def send(self, message: dict[str, Any]) -> None:
        """Send a message at once. BrokenPipeError ends the process if the parent is gone."""
        self._channel.write(json.dumps(message) + "\n")
        self._channel.flush()


def main() -> None:
    """Load the problem, solve it, and report the result."""
    folder, request_path, channel = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # an abort must not leave a core file
    process_memory.go_first_when_memory_ends()
    request = json.loads(request_path.read_text())
    options = SolveOptions(**request["options"])
    with os.fdopen(channel, "w", encoding="ascii") as file:
        reporter = Reporter(file)
        try:
            reporter.send(_run(folder, options, request, reporter))
        except InputError as error:
            # Running out of memory under a cap is an outcome; on the whole machine it is an error.
            is_beyond = isinstance(error, _core.NotEnoughMemoryError) and request["memory_cap"] > 0
            reporter.send({"out_of_memory": True} if is_beyond else {"refused": str(error)})
        except MemoryError:
            reporter.send({"out_of_memory": True})


def _run(
    folder: Path, options: SolveOptions, request: dict[str, Any], reporter: Reporter
) -> dict[str, Any]:
    problem = restore(folder)
    if request.get("start") is not None:
        problem = restore_solution(problem, Path(request["start"]))
    load_peak = process_memory.peak_memory()
    resident = process_memory.resident_memory()
    knows_growth = process_memory.restart_peak()
    reporter.send({"resident": resident})
    if request["memory_cap"]:
        process_memory.limit_growth(request["memory_cap"], options.num_threads)
    load, begun, cpu = load_average(), time.perf_counter(), time.process_time()
    result = solve(problem, options, progress=reporter.iteration)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - begun
    peak = process_memory.peak_memory()
    if request.get("solution") is not None and result.summary.is_solution_usable:
        store_solution(result.problem, Path(request["solution"]))
    return {
        "measurement": {
            **_measured(result),
            "peak_memory_in_bytes": max(peak, load_peak),
            "added_memory_in_bytes": max(peak - resident, 0) if knows_growth else -1,
            "cpu_per_wall": cpu / max(wall, 1e-9),
            "load": load,
        }
    }


def _measured(result: Result) -> dict[str, Any]:
    return {
        "summary": dataclasses.asdict(result.summary),
        "iterations": {name: column.tolist() for name, column in result.iterations.items()},
        "build_time_in_seconds": result.build_time_in_seconds,
        "solve_time_in_seconds": result.solve_time_in_seconds,
    }


if __name__ == "__main__":
    main()
