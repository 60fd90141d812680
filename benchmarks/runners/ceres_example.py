"""Ceres' own bundle_adjuster example, a program of its own that this runner starts.

It is given the problem as plain text, everybody's tolerances, LAPACK for dense matrices, and the
elimination order that it calls ``user``: points first. It moves and scales the scene before it
starts, which leaves the cost as it is but not the steps, and keeps the algebraic residual of an
observation behind its camera. How long it takes to build its problem it does not say.

Nothing large is imported before it has ended: the kernel's peak memory of a child is never below
what its parent had when it started it.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO, Any

from benchmarks import ceres_example
from benchmarks.runners import ceres_log, protocol


def _as_text(path: Path, target: Path) -> Path:
    """Return the plain BAL file, decompressed piece by piece into ``target`` if need be."""
    import bz2
    import gzip

    opener: Any = {".bz2": bz2.open, ".gz": gzip.open}.get(path.suffix)
    if opener is None:
        return path
    with opener(path, "rb") as source, target.open("wb") as file:
        shutil.copyfileobj(source, file)
    return target


def _command(binary: Path, problem: Path, output: Path, request: protocol.Request) -> list[str]:
    return [
        str(binary),
        f"--input={problem}",
        f"--final_ply={output}",
        f"--linear_solver={request.solver.replace('-', '_')}",
        f"--num_threads={request.threads}",
        f"--num_iterations={request.max_num_iterations}",
        "--ordering=user",
        "--dense_linear_algebra_library=lapack",
        "--preconditioner=schur_jacobi",
        "--eta=0.1",  # Ceres' default; the example's own is 0.01
    ]


def _tolerances(request: protocol.Request) -> dict[str, str]:
    return {
        "FUNCTION_TOLERANCE": f"{request.function_tolerance:.17g}",
        "GRADIENT_TOLERANCE": f"{request.gradient_tolerance:.17g}",
        "PARAMETER_TOLERANCE": f"{request.parameter_tolerance:.17g}",
    }


def _run(command: list[str], env: dict[str, str], log: IO[bytes]) -> int:
    """Run the example and return its peak memory in bytes.

    Raises:
        RuntimeError: it failed; its last line.
    """
    process = subprocess.Popen(command, env=env, stdout=log, stderr=log)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        log.seek(0)
        words = log.read().decode(errors="replace").strip().splitlines()
        raise RuntimeError(f"exit {process.returncode}: {words[-1] if words else 'no message'}")
    return usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def _verified_cost(problem: Path, output: Path) -> float:
    """Return the cost of the parameters it wrote; the observations it wrote have six digits."""
    import dataclasses

    from benchmarks import bal

    refined = bal.read(output)
    original = bal.read(problem)
    return bal.cost(
        dataclasses.replace(original, cameras=refined.cameras, points=refined.points),
        behind="algebraic",
    )


def run(request: protocol.Request) -> protocol.Outcome:
    """Run the example and read what it printed and wrote."""
    if request.kind != "bal":
        raise protocol.NotApplicableError("it reads BAL files only")
    binary = ceres_example.binary()
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile() as log:
        problem = _as_text(request.path, Path(folder) / "problem.txt")
        output = Path(folder) / "refined.txt"
        command = _command(binary, problem, output, request)
        memory = _run(command, {**os.environ, **_tolerances(request)}, log)
        log.seek(0)
        text = log.read().decode()
        verified = _verified_cost(problem, output)
    report = ceres_log.report(text)
    return protocol.Outcome(
        load=0.0,
        build=0.0,
        solve=report.total_time,
        minimizer=report.minimizer_time,
        num_steps=report.num_linear_solves,
        trace=ceres_log.iterations(text, verified),
        initial_cost=report.initial_cost,
        final_cost=report.final_cost,
        termination=report.termination,
        verified_cost=verified,
        peak_memory=memory,
        notes=[report.linear_solver, report.schur_structure],
        versions={"Ceres of the example": report.ceres},
    )


if __name__ == "__main__":
    protocol.main(run)
