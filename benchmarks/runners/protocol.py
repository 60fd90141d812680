"""Request of run.py to a runner and its answer, both as JSON files."""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

SETTLE = 0.2
"""Seconds between the imports and the run: threads of OpenBLAS, which NumPy and others start when
they are imported, spin for up to 0.1 s and take a core from every solver."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """One problem for one solver.

    ``path`` is a BAL file or a COLMAP folder (``kind`` "bal" or "colmap"). ``backend`` is bundle's
    alone. ``memory_limit`` is in bytes of address space, 0 for none. The tolerances are Ceres'; a
    runner whose solver lacks one leaves it out.
    """

    path: Path
    kind: str
    solver: str
    backend: str
    threads: int
    memory_limit: int
    max_num_iterations: int
    function_tolerance: float
    gradient_tolerance: float
    parameter_tolerance: float


@dataclass(kw_only=True)
class Outcome:
    """Measurements of a runner; times in seconds, costs 1/2 sum ||r||^2 in pixels squared.

    Attributes:
        load: file -> the solver's own data structures.
        build: those -> an optimiser that is ready to start.
        solve: inside the optimiser, from start to finished state.
        minimizer: the part of ``solve`` that is spent on LM steps; without preprocessing.
        num_steps: LM steps tried, i.e. linear systems solved, accepted or not.
        trace: (seconds since the loaded problem was handed over, cost), the first at the start.
        final_cost: what the solver says.
        verified_cost: what bal.cost or colmap.cost says of the refined parameters.
        peak_memory: bytes, whole process, before the verification.
        added_memory: bytes, the peak of solving beyond the loaded problem; -1 if not measured.
        notes: the linear solver used, and its structure.
        size: of the problem, where the runner says it: "images", "points", "observations",
            "image_pairs", the sum of L (L - 1) / 2 over all track lengths L, "cameras",
            "camera_columns", the refined parameters of the first one, and "rigs", 1 if it has any.
        versions: of the libraries behind the numbers.
    """

    load: float
    build: float
    solve: float
    minimizer: float
    num_steps: int
    trace: list[tuple[float, float]]
    initial_cost: float
    final_cost: float
    termination: str
    verified_cost: float
    peak_memory: int
    added_memory: int = -1
    notes: list[str] = field(default_factory=list)
    size: dict[str, int] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)


class NotApplicableError(Exception):
    """The solver cannot be given this problem; the message is the row's reason."""


def peak_memory() -> int:
    """Return the largest resident size of this process so far, in bytes.

    VmHWM belongs to this program alone; ru_maxrss would include the parent's size at the fork.
    """
    try:
        return _status("VmHWM")
    except (OSError, IndexError):
        unit = 1 if sys.platform == "darwin" else 1024
        return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def restart_peak_memory() -> int:
    """Let ``peak_memory`` count anew; return the resident size in bytes, -1 where that cannot be.

    What a loader needed for a moment would otherwise hide what the solver adds.
    """
    try:
        Path("/proc/self/clear_refs").write_text("5")
        return _status("VmRSS")
    except (OSError, IndexError):
        return -1


def _status(field: str) -> int:
    text = Path("/proc/self/status").read_text()
    return 1024 * int(text.split(f"{field}:")[1].split()[0])


def pin(threads: int) -> None:
    """Keep this process on as many cores as it may have threads: no solver gets a helper core."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])


def limit_memory(size: int) -> None:
    """Make allocations beyond ``size`` bytes fail, here and in children: 0 for no limit."""
    if size:
        resource.setrlimit(resource.RLIMIT_AS, (size, size))


def main(run: Callable[[Request], Outcome]) -> None:
    """Read the request named first on the command line, run it, write the answer to the second."""
    request_path, answer_path = (Path(argument) for argument in sys.argv[1:3])
    fields = json.loads(request_path.read_text())
    request = Request(**{**fields, "path": Path(fields["path"])})
    pin(request.threads)
    limit_memory(request.memory_limit)
    time.sleep(SETTLE)
    try:
        answer = dataclasses.asdict(run(request))
    except NotApplicableError as reason:
        answer = {"failure": str(reason)}
    except MemoryError:
        answer = {"failure": f"more than the memory limit of {request.memory_limit / 1e9:.0f} GB"}
    except Exception as error:  # a failed solver is a row, not the end of the benchmark
        answer = {"failure": f"{type(error).__name__}: {error}".splitlines()[0]}
    answer_path.write_text(json.dumps(answer))
