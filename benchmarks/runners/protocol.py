"""What run.py asks of a runner and what a runner answers, both as JSON files."""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Request:
    """One problem for one solver.

    ``path`` is a BAL file or a COLMAP folder (``kind`` "bal" or "colmap"). The tolerances are
    Ceres'; a runner whose solver lacks one leaves it out.
    """

    path: Path
    kind: str
    solver: str
    threads: int
    max_num_iterations: int
    function_tolerance: float
    gradient_tolerance: float
    parameter_tolerance: float


@dataclass(kw_only=True)
class Outcome:
    """What a runner measured; times in seconds, costs 1/2 sum ||r||^2 in pixels squared.

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
        notes: the linear solver used, and its structure.
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
    notes: list[str] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)


class NotApplicableError(Exception):
    """The solver cannot be given this problem; the message is the row's reason."""


def peak_memory() -> int:
    """Return the largest resident size of this process so far, in bytes.

    VmHWM belongs to this program alone; ru_maxrss would include the parent's size at the fork.
    """
    try:
        status = Path("/proc/self/status").read_text()
        return 1024 * int(status.split("VmHWM:")[1].split()[0])
    except (OSError, IndexError):
        unit = 1 if sys.platform == "darwin" else 1024
        return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def pin(threads: int) -> None:
    """Keep this process on as many cores as it may have threads: no solver gets a helper core."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])


def main(run: Callable[[Request], Outcome]) -> None:
    """Read the request named first on the command line, run it, write the answer to the second."""
    request_path, answer_path = (Path(argument) for argument in sys.argv[1:3])
    fields = json.loads(request_path.read_text())
    request = Request(**{**fields, "path": Path(fields["path"])})
    pin(request.threads)
    try:
        answer = dataclasses.asdict(run(request))
    except NotApplicableError as reason:
        answer = {"failure": str(reason)}
    except Exception as error:  # a failed solver is a row, not the end of the benchmark
        answer = {"failure": f"{type(error).__name__}: {error}".splitlines()[0]}
    answer_path.write_text(json.dumps(answer))
