"""One worker process: start, messages, limits, and all kinds of ends."""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import field
from pathlib import Path
from typing import IO, Any

from bundle.base.own_process import interrupts_deferred
from bundle.base.records import dataclass
from bundle.base.words import format_size
from bundle.planning.comparison import process_memory

SECONDS_BETWEEN_LOOKS = 0.05
SECONDS_TO_END = 10.0
_MEMORY_WORDS = re.compile(
    r"out of memory|bad_alloc|cannot allocate memory|memory allocation", re.IGNORECASE
)


@dataclass(kw_only=True)
class WorkerEnd:
    """End of a worker: an outcome of ``Run``, and the messages received before.

    Attributes:
        outcome: "done" for any termination type of the solver.
        iterations: iterations that it sent; the latest may be missing.
    """

    outcome: str = ""
    message: str = ""
    measurement: dict[str, Any] | None = None
    iterations: list[dict[str, Any]] = field(default_factory=list)


def worker_command(folder: Path, request: Path, channel: int) -> list[str]:
    """Return the command that runs one worker."""
    module = "bundle.planning.comparison.worker"
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
        grown = process_memory.resident_memory(process.pid) - resident
        if memory_cap and resident and grown > memory_cap:
            end.outcome, end.message = "out_of_memory", beyond(memory_cap)
            return end
        if time.monotonic() > deadline:
            end.outcome, end.message = "timed_out", _too_long(timeout, end.iterations)
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


def _too_long(timeout: float, iterations: Sequence[dict[str, Any]]) -> str:
    words = f"stopped after the time-out of {timeout:g} s"
    if iterations:
        latest = iterations[-1]
        words += f", at iteration {latest['iteration']} and cost {latest['cost']:.4e}"
    return words


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
