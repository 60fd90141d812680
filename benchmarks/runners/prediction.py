"""One prediction, or one solve to hold it against; see benchmarks/predictions.py.

The memory is the peak of bundle.solve beyond the loaded problem. Tolerances are zero, so that there
are as many steps as are asked for, unless the cost cannot fall any more. The steps of a solve that
takes less than a second are timed when it is run again: the first ones of a process also load
libraries and touch memory for the first time, which is no part of what a step costs.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import statistics
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bundle
from benchmarks.runners import protocol
from bundle.interface.options import AUTO_PRECONDITIONER

STEPS = 5
SHORT = 1.0  # seconds


def calibrate(threads: int) -> dict[str, Any]:
    """Measure this machine's rates anew."""
    from bundle.planning.inspection.problem_time import problem_rates

    problem_rates(threads, recalibrate=True)
    return {}


def inspect(path: str, threads: int) -> dict[str, Any]:
    """Return the predictions by "backend solver", with the preconditioners that auto takes."""
    found: dict[str, Any] = {}
    for method in bundle.inspect(bundle.load(path), num_threads=threads).methods:
        key = (method.backend.lower(), method.linear_solver_type.lower())
        is_usual = method.preconditioner.lower() == AUTO_PRECONDITIONER.get(key, "")
        if not (method.is_taken and is_usual) or method.ordering == "cameras_first":
            continue
        found[" ".join(key)] = {
            "nnz_factor": method.nnz_factor,
            "memory": method.memory_in_bytes,
            "seconds": method.time_per_step_in_seconds,
            "fits_in_memory": method.fits_in_memory,
        }
    return found


def solve(path: str, backend: str, solver: str, threads: int) -> dict[str, Any]:
    """Solve for a few steps."""
    problem = bundle.load(path)
    give_back_free_memory()
    loaded = protocol.restart_peak_memory()
    options = bundle.SolveOptions(
        backend=backend,
        linear_solver_type=solver,
        num_threads=threads,
        max_num_iterations=STEPS,
        function_tolerance=0.0,
        gradient_tolerance=0.0,
        parameter_tolerance=0.0,
    )
    result = bundle.solve(problem, options)
    peak = protocol.peak_memory()
    summary = result.summary
    if summary.total_time_in_seconds < SHORT:
        result = bundle.solve(problem, options)
    steps = result.iterations["iteration_time_in_seconds"][1:].tolist()
    return {
        "nnz_factor": summary.num_factor_nonzeros,
        "memory": peak - loaded if loaded >= 0 else None,
        "seconds": statistics.median(steps),
        "minimizer": summary.minimizer_time_in_seconds / max(summary.num_linear_solves, 1),
    }


def give_back_free_memory() -> None:
    """Return to the system what loading has freed: what the solver takes of it would not show."""
    with contextlib.suppress(OSError, AttributeError):  # glibc has it
        ctypes.CDLL(None).malloc_trim(0)


def main() -> None:
    """Read the request named first on the command line, write the answer to the second."""
    request_path, answer_path = (Path(argument) for argument in sys.argv[1:3])
    request = json.loads(request_path.read_text())
    protocol.pin(request["threads"])
    actions: dict[str, Callable[..., dict[str, Any]]] = {
        "calibrate": calibrate,
        "inspect": inspect,
        "solve": solve,
    }
    action = actions[request.pop("do")]
    try:
        answer = action(**request)
    except Exception as error:  # a failed solve is a row, not the end of the table
        answer = {"failure": f"{type(error).__name__}: {error}".splitlines()[0]}
    answer_path.write_text(json.dumps(answer))


if __name__ == "__main__":
    main()
