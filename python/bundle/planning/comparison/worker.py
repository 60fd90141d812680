"""Worker of one run: ``python -m bundle.planning.comparison.worker FOLDER REQUEST CHANNEL``.

FOLDER contains the problem. REQUEST is a JSON file of options and limits. It
may have two paths: "start" has the values to start from, "solution" receives the result.
CHANNEL is the number of an open file that receives one JSON object per line:

- ``{"resident": bytes}`` once the problem is loaded,
- ``{"iterations": [...]}`` regularly, by the names of Ceres' IterationSummary,
- one of ``{"measurement": {...}}``, ``{"refused": why}`` and ``{"out_of_memory": true}``.

Libraries may print to standard output and error.

Problem on disk for other processes: one file per array, for fast reading from the disk cache.

Data that is needed only for writing a model (names, the original reconstruction) is not stored.
"""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import sys
import time
from pathlib import Path
from typing import Any, Literal, TextIO

import numpy as np

import bundle._core as _core
from bundle.base.arrays import freeze
from bundle.errors import InputError
from bundle.interface.environment import load_average
from bundle.interface.options import SolveOptions
from bundle.model.estimates import estimates, with_estimates
from bundle.model.problem import Problem
from bundle.model.rolling_shutter import RollingShutter
from bundle.planning.comparison import process
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
    process.go_first_when_memory_ends()
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
    load_peak = process.peak_memory()
    resident = process.resident_memory()
    knows_growth = process.restart_peak()
    reporter.send({"resident": resident})
    if request["memory_cap"]:
        process.limit_growth(request["memory_cap"], options.num_threads)
    load, begun, cpu = load_average(), time.perf_counter(), time.process_time()
    result = solve(problem, options, progress=reporter.iteration)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - begun
    peak = process.peak_memory()
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


_REST = "problem.json"


def store(problem: Problem, folder: Path) -> None:
    """Write a problem into a new folder."""
    folder.mkdir()
    for name, value in vars(problem).items():
        if isinstance(value, np.ndarray):
            np.save(folder / f"{name}.npy", value)
    rest = {
        "camera_models": problem.camera_models,
        "image_names": problem.image_names,
        "format": problem.format,
        "rolling_shutter": _as_lists(problem.rolling_shutter),
    }
    (folder / _REST).write_text(json.dumps(rest))


def restore(folder: Path, mmap_mode: Literal["r"] | None = None) -> Problem:
    """Read a problem; with mmap_mode "r" only the accessed pages take memory."""
    # No other process writes to these files, so memory-mapped arrays need no copy.
    arrays: dict[str, Any] = {
        path.stem: freeze(np.load(path, mmap_mode=mmap_mode))
        for path in sorted(folder.glob("*.npy"))
    }
    rest = json.loads((folder / _REST).read_text())
    if rest["rolling_shutter"] is not None:
        rest["rolling_shutter"] = RollingShutter(**rest["rolling_shutter"])
    return Problem(**arrays, **rest)


def store_solution(problem: Problem, path: Path) -> None:
    """Write the values that a solve changes."""
    with path.open("wb") as file:
        np.savez(file, **dict[str, Any](estimates(problem)))


def restore_solution(problem: Problem, path: Path) -> Problem:
    """Return the problem with the values of a stored solution."""
    with np.load(path) as arrays:
        return with_estimates(problem, arrays, checked=True)


def _as_lists(shutter: RollingShutter | None) -> dict[str, Any] | None:
    """Return the fields of rolling shutters as JSON values, which keep every bit."""
    if shutter is None:
        return None
    fields = {field.name: getattr(shutter, field.name) for field in dataclasses.fields(shutter)}
    del fields["axis"]  # computed from the directions
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in fields.items()
    }


if __name__ == "__main__":
    main()
