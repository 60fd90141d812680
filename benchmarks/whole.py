"""Whole processes, start to exit: `bundle refine` against the same work through pycolmap."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.measure import Spread, run_child
from benchmarks.problems import ROOT, BenchmarkProblem

OURS, THEIRS = "bundle refine", "pycolmap script"
REPEATS = 11
"""Runs of a COLMAP model, at least: a few tenths of a second, which scatter more than a solve."""
# What the installed command runs, without asking where it is installed.
COMMAND = "import sys; from bundle.__main__ import run; sys.exit(run())"


@dataclass(frozen=True)
class Job:
    """A command line and what it writes."""

    command: list[str]
    output: Path


def jobs(
    problem: BenchmarkProblem, stopping: Mapping[str, float], threads: int, folder: Path
) -> dict[str, Job]:
    """Return both jobs; outputs are new names in the folder, of the input's format."""
    suffix = ".txt" if problem.kind == "bal" else ""
    ours, theirs = folder / f"ours{suffix}", folder / f"theirs{suffix}"
    values = [f"{value:g}" for value in stopping.values()]
    flags = ["--max-iterations", "--function-tolerance", "--gradient-tolerance"]
    flags.append("--parameter-tolerance")
    rule = [word for pair in zip(flags, values, strict=True) for word in pair]
    refine = [
        sys.executable,
        "-c",
        COMMAND,
        "refine",
        str(problem.path),
        "-o",
        str(ours),
        "--quiet",
    ]
    if problem.kind == "bal":
        script = [sys.executable, "-m", "benchmarks.runners.pycolmap_process"]
    else:
        script = [sys.executable, str(ROOT / "benchmarks" / "runners" / "pycolmap_model.py")]
    return {
        OURS: Job([*refine, "--threads", str(threads), "--convergence", "ceres", *rule], ours),
        THEIRS: Job([*script, str(problem.path), str(theirs), str(threads), *values], theirs),
    }


def run(job: Job, env: dict[str, str], timeout: float) -> dict[str, Any]:
    """Run a job; return what goes into the JSON. A job that leaves no output has failed."""
    child = run_child(job.command, env, timeout)
    failure = child.failure
    if not failure and not job.output.exists():
        failure = "wrote nothing"
    return {
        "failure": failure,
        "wall": child.wall,
        "cpu": child.cpu,
        "peak_memory": child.peak_memory,
    }


def final_cost(path: Path, kind: str) -> float:
    """Return the cost of what a job wrote. Imports NumPy: call it when all is measured."""
    from benchmarks import bal, colmap

    if kind == "bal":
        return bal.cost(bal.read(path))
    import pycolmap

    return colmap.cost(pycolmap.Reconstruction(path))


def cpu(runs: Sequence[Mapping[str, Any]]) -> Spread | None:
    """Return CPU seconds over the repeats, None if one failed; a busy machine matters less."""
    return Spread.of(None if run["failure"] else run["cpu"] for run in runs)


def spreads(runs: Sequence[Mapping[str, Any]]) -> tuple[Spread | None, Spread | None]:
    """Return wall seconds and peak bytes over the repeats; None if one failed."""
    wall = Spread.of(None if run["failure"] else run["wall"] for run in runs)
    memory = Spread.of(None if run["failure"] else run["peak_memory"] for run in runs)
    return wall, memory
