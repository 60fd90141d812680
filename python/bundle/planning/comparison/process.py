"""One worker process: start, messages, limits, ways to end, and its work.

Memory of a process, and a limit on it.

The report and the cap count resident memory. The kernel cannot limit it for a single process,
so two mechanisms enforce the cap:

- RLIMIT_DATA, which the process sets after loading its problem. An allocation beyond the cap fails
  before its memory is touched: a dense matrix of 3 GB under a cap of 500 MB is never allocated.
  RLIMIT_AS is unsuitable: it counts libraries, files and reserved address space (64 MiB per malloc
  arena). RLIMIT_DATA still counts stacks and the buffers of OpenBLAS (128 MiB per thread), which
  are reserved in full and touched in part; `_reserve` adds them to the cap, because OpenBLAS blocks
  for ever if it cannot get a buffer.
- The parent, which reads the resident size several times a second and kills a process above the
  cap.

If a process exceeds the cap between two readings and then ends, its peak reveals it.

Worker of one run: ``python -m bundle.planning.comparison.process FOLDER REQUEST CHANNEL``.

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

import contextlib
import dataclasses
import json
import os
import re
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import field
from pathlib import Path
from typing import IO, Any, Literal, TextIO

import numpy as np

import bundle._core as _core
from bundle.base.arrays import freeze
from bundle.base.own_process import interrupts_deferred
from bundle.base.records import dataclass
from bundle.base.words import format_size
from bundle.errors import InputError
from bundle.interface.environment import load_average
from bundle.interface.options import SolveOptions
from bundle.model.estimates import estimates, with_estimates
from bundle.model.problem import Problem
from bundle.model.rolling_shutter import RollingShutter
from bundle.solving.result import Result
from bundle.solving.solve import solve

SECONDS_BETWEEN_LOOKS = 0.05
SECONDS_TO_END = 10.0
_MEMORY_WORDS = re.compile(
    r"out of memory|bad_alloc|cannot allocate memory|memory allocation", re.IGNORECASE
)


@dataclass(kw_only=True)
class WorkerEnd:
    """End of a worker: an outcome of ``Run``, and the messages received before."""

    outcome: str = ""  # "done" for any termination type of the solver
    message: str = ""
    measurement: dict[str, Any] | None = None
    # iterations that it sent; the latest may be missing
    iterations: list[dict[str, Any]] = field(default_factory=list)


def worker_command(folder: Path, request: Path, channel: int) -> list[str]:
    """Return the command that runs one worker."""
    module = "bundle.planning.comparison.process"
    return [sys.executable, "-P", "-m", module, str(folder), str(request), str(channel)]


def run_worker(
    folder: Path,
    request: Path,
    *,
    timeout: float,
    memory_cap: int,
    on_iteration: Callable[[dict[str, Any]], None],
) -> WorkerEnd:
    """Run a worker; kill it and its children when it exceeds a limit.

    ``timeout``: seconds from the loading of the problem. ``memory_cap``: bytes beyond the loaded
    problem; 0: no cap. ``on_iteration``: called regularly with the latest iteration.
    """
    with contextlib.ExitStack() as open_things:
        with interrupts_deferred():  # an interrupted constructor leaves a file or process behind
            reader, writer = os.pipe()
            channel = open_things.enter_context(os.fdopen(reader, "rb", buffering=0))
            try:
                words = open_things.enter_context(tempfile.TemporaryFile())
                process = subprocess.Popen(
                    worker_command(folder, request, writer),
                    env=_environment(),
                    stdin=subprocess.DEVNULL,
                    stdout=words,
                    stderr=words,
                    pass_fds=(writer,),
                    # Ctrl-C goes to the parent only, and killing the group reaches all
                    process_group=0,
                )
            finally:
                os.close(writer)
            open_things.callback(_kill, process)
        try:
            end = _listen(process, channel, timeout, memory_cap, on_iteration)
            if not end.outcome:  # the channel closes only when the worker ends
                process.wait(SECONDS_TO_END)
        except subprocess.TimeoutExpired:
            end = WorkerEnd(outcome="died", message="the process stopped responding")
        _kill(process)
        words.seek(0)
        return _explained(end, process.returncode, words.read().decode(errors="replace"))


def _listen(
    process: subprocess.Popen[bytes],
    channel: IO[bytes],
    timeout: float,
    memory_cap: int,
    on_iteration: Callable[[dict[str, Any]], None],
) -> WorkerEnd:
    """Receive messages until the last one or until a limit is reached."""
    end = WorkerEnd()
    deadline = time.monotonic() + timeout
    resident, unread = 0, b""
    while True:
        if select.select([channel], [], [], SECONDS_BETWEEN_LOOKS)[0]:
            received = channel.read(1 << 16)
            if not received:
                return end
            *lines, unread = (unread + received).split(b"\n")
            for message in map(json.loads, lines):
                if "resident" in message:
                    resident, deadline = message["resident"], time.monotonic() + timeout
                else:
                    _take(end, message, memory_cap)
                if message.get("iterations"):
                    on_iteration(message["iterations"][-1])
        if end.outcome:
            return end
        grown = resident_memory(process.pid) - resident
        if memory_cap and resident and grown > memory_cap:
            end.outcome, end.message = "out_of_memory", beyond(memory_cap)
            return end
        if time.monotonic() > deadline:
            words = f"stopped after the time-out of {timeout:g} s"
            if end.iterations:
                latest = end.iterations[-1]
                words += f", at iteration {latest['iteration']} and cost {latest['cost']:.4e}"
            end.outcome, end.message = "timed_out", words
            return end


def _take(end: WorkerEnd, message: dict[str, Any], memory_cap: int) -> None:
    """Record a message of a worker."""
    end.iterations += message.get("iterations", [])
    if "refused" in message:
        end.outcome, end.message = "refused", message["refused"]
    elif "out_of_memory" in message:
        end.outcome, end.message = "out_of_memory", beyond(memory_cap)
    elif "measurement" in message:
        added = message["measurement"]["added_memory_in_bytes"]
        if memory_cap and added > memory_cap:
            end.outcome = "out_of_memory"
            end.message = f"{beyond(memory_cap)}: {format_size(added)}"
        else:
            end.outcome, end.measurement = "done", message["measurement"]


def beyond(memory_cap: int) -> str:
    """Return text such as "needed more than 500 MB beyond the loaded problem"."""
    if not memory_cap:
        return "ran out of memory"
    return f"needed more than {format_size(memory_cap)} beyond the loaded problem"


def _explained(end: WorkerEnd, code: int, words: str) -> WorkerEnd:
    """Set the outcome of a worker that ended without a message, from its exit code and output."""
    said = [line.strip() for line in words.splitlines() if line.strip()]
    if end.outcome == "done" and end.measurement is not None:
        failed = end.measurement["summary"]["termination_type"] == "FAILURE"
        if failed and _MEMORY_WORDS.search(words):
            end.outcome, end.message, end.measurement = "out_of_memory", "ran out of memory", None
    if end.outcome:
        return end
    name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
    if _MEMORY_WORDS.search(words):
        end.outcome, end.message = "out_of_memory", f"ran out of memory ({name})"
    elif code == -signal.SIGKILL:
        end.outcome = "died"
        end.message = "the process was killed from outside, possibly for lack of memory"
    else:
        end.outcome = "died"
        why = f": {said[-1]}" if said else " and gave no message"
        end.message = f"the process ended with {name}{why}"
    return end


def _environment() -> dict[str, str]:
    """Return this environment, with the module search path of this process."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}


def _kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a running process and its children, and wait for it."""
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


_MIB = 2**20
_BLAS_BUFFER = 128 * _MIB
_ARENAS = 64 * _MIB
_SOME_STACK = 8 * _MIB


def available_memory() -> int:
    """Return the free memory of this machine in bytes; 0 if the system does not report it."""
    size = _core.available_memory()
    return int(size) if size < 2**63 else 0


def resident_memory(pid: int | str = "self") -> int:
    """Return the resident bytes of a process; 0 if the system does not report them."""
    return _kibibytes(Path(f"/proc/{pid}/status"), "VmRSS")


def peak_memory() -> int:
    """Return the peak resident size of this process in bytes.

    VmHWM counts this program only; the fallback ru_maxrss includes the parent's size at the fork.
    """
    unit = 1 if sys.platform == "darwin" else 1024
    peak = unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return _kibibytes(Path("/proc/self/status"), "VmHWM") or peak


def restart_peak() -> bool:
    """Reset the peak that `peak_memory` returns; False if the system does not allow it.

    Otherwise a loader's temporary memory would hide the memory of the solver.
    """
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return False
    return True


def limit_growth(size: int, num_threads: int) -> None:
    """Make allocations fail that grow this process by more than `size` bytes from now on."""
    data = _kibibytes(Path("/proc/self/status"), "VmData")
    if not data:
        return
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = data + size + _reserve(num_threads)
    if most == resource.RLIM_INFINITY or limit < most:
        resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def go_first_when_memory_ends() -> None:
    """Tell the kernel to kill this process first if the machine runs out of memory."""
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("1000")


def _reserve(num_threads: int) -> int:
    """Return the number of bytes that threads reserve but do not use: stacks and buffers."""
    stack, _ = resource.getrlimit(resource.RLIMIT_STACK)
    stack = _SOME_STACK if stack == resource.RLIM_INFINITY else stack
    cores = max(num_threads, os.cpu_count() or 1)  # OpenBLAS starts one thread per core
    return (cores + 1) * (stack + _BLAS_BUFFER) + _ARENAS


def _kibibytes(path: Path, field: str) -> int:
    """Return the value of a line "field:   123 kB" in bytes; 0 without such a line."""
    try:
        _, found, rest = path.read_text().partition(f"{field}:")
        return 1024 * int(rest.split(maxsplit=1)[0]) if found else 0
    except (OSError, ValueError, IndexError):
        return 0


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
    go_first_when_memory_ends()
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
    load_peak = peak_memory()
    resident = resident_memory()
    knows_growth = restart_peak()
    reporter.send({"resident": resident})
    if request["memory_cap"]:
        limit_growth(request["memory_cap"], options.num_threads)
    load, begun, cpu = load_average(), time.perf_counter(), time.process_time()
    result = solve(problem, options, progress=reporter.iteration)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - begun
    peak = peak_memory()
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
