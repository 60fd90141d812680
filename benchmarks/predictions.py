"""Predictions of `bundle inspect` against measured solves.

    python -m benchmarks.predictions [--only NAMES] [--threads N] [--repeat N] [--json FILE]

Every prediction and every solve is a process of its own. The rates of the machine are measured
anew first, under the same conditions as the solves. A row is marked where nonzeros differ, memory
is off by more than 25 % or the time of a step by more than a factor of two; those of iterative
solvers are shown, not judged. `runners/prediction.py` is the process.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import measure, problems, synthetic
from benchmarks.problems import BenchmarkProblem

SYNTHETIC = ("street-50", "street-200", "street-1000", "photo-collection-1000")
SOLVES = (
    ("fused", "dense_schur"),
    ("fused", "sparse_schur"),
    ("fused", "iterative_schur"),
    ("ceres", "dense_schur"),
    ("ceres", "sparse_schur"),
    ("ceres", "sparse_normal_cholesky"),
    ("ceres", "iterative_schur"),
)
MEMORY_OFF, TIME_OFF = 1.25, 2.0
TIMEOUT = 900.0


@dataclass(frozen=True)
class Row:
    """One method on one problem; None where a number was not measured, or not predicted.

    Attributes:
        nnz_factor, memory, seconds: (predicted, measured); bytes and seconds a step.
    """

    problem: str
    method: str
    nnz_factor: tuple[float | None, float | None]
    memory: tuple[float | None, float | None]
    seconds: tuple[float | None, float | None]
    failure: str = ""

    @property
    def is_direct(self) -> bool:
        """True if the prediction meets the targets."""
        return "iterative" not in self.method

    @property
    def misses(self) -> tuple[str, ...]:
        """Name the predictions that are off by more than they may be."""
        if not self.is_direct:
            return ()
        found = []
        predicted, measured = self.nnz_factor
        if predicted is not None and measured is not None and predicted != measured:
            found.append("nonzeros")
        if off(self.memory) > MEMORY_OFF:
            found.append("memory")
        if off(self.seconds) > TIME_OFF:
            found.append("time")
        return tuple(found)


def ratio(pair: tuple[float | None, float | None]) -> float | None:
    """Return predicted over measured."""
    predicted, measured = pair
    return predicted / measured if predicted and measured else None


def off(pair: tuple[float | None, float | None]) -> float:
    """Return by which factor a prediction is off, in either direction; 1 if it is not known."""
    value = ratio(pair)
    return 1.0 if value is None else max(value, 1.0 / value)


def ask(request: dict[str, Any], threads: int) -> dict[str, Any]:
    """Return what a process of its own answers, or {"failure": why not}."""
    with tempfile.TemporaryDirectory() as folder:
        question, answer = Path(folder) / "request.json", Path(folder) / "answer.json"
        question.write_text(json.dumps(request))
        command = [sys.executable, "-m", "benchmarks.runners.prediction", question, answer]
        env = measure.environment(problems.ROOT, threads)
        child = measure.run_child([str(word) for word in command], env, TIMEOUT)
        if child.failure:
            return {"failure": child.failure}
        answered: dict[str, Any] = json.loads(answer.read_text())
        return answered


def rows_of(problem: BenchmarkProblem, threads: int, repeat: int) -> list[Row]:
    """Predict and solve a problem by every method that fits into memory."""
    common = {"path": str(problem.path), "threads": threads}
    predictions = ask({"do": "inspect", **common}, threads)
    rows = []
    for backend, solver in SOLVES:
        method = f"{backend} {solver.replace('_', '-')}"
        predicted = predictions.get(f"{backend} {solver}", {})
        if not predicted.get("fits_in_memory", True):
            failure = "not tried: does not fit into memory"
            rows.append(_row(problem.name, method, predicted, {"failure": failure}))
            continue
        request = {"do": "solve", "backend": backend, "solver": solver, **common}
        runs = [ask(request, threads) for _ in range(repeat)]
        rows.append(_row(problem.name, method, predicted, _best(runs)))
        print(".", end="", file=sys.stderr, flush=True)
    print(f" {problem.name}", file=sys.stderr)
    return rows


def _best(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the medians of repeated runs."""
    good = [run for run in runs if not run.get("failure")]
    if not good:
        return runs[0]
    names = [name for name, value in good[0].items() if value is not None]
    return {name: statistics.median(run[name] for run in good) for name in names}


def _row(problem: str, method: str, predicted: dict[str, Any], measured: dict[str, Any]) -> Row:
    pairs = {
        name: (predicted.get(name), measured.get(name))
        for name in ("nnz_factor", "memory", "seconds")
    }
    return Row(problem=problem, method=method, failure=measured.get("failure", ""), **pairs)


HEAD = """\
| problem | method | nonzeros of L | reported | memory | measured | ratio \
| a step | measured | ratio | off |
| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | --- |"""


def line(row: Row) -> str:
    """Return a row in Markdown."""
    cells = [
        row.problem,
        row.method,
        *(_number(value, "{:.0f}") for value in row.nnz_factor),
        *(_number(value, "{:.1f} MB", 1e-6) for value in row.memory),
        _number(ratio(row.memory), "{:.2f}"),
        *(_number(value, "{:.2f} ms", 1e3) for value in row.seconds),
        _number(ratio(row.seconds), "{:.2f}"),
        row.failure or ", ".join(row.misses),
    ]
    return f"| {' | '.join(cells)} |"


def verdict(rows: Sequence[Row]) -> str:
    """Return how many predictions of direct solvers are off."""
    direct = [row for row in rows if row.is_direct and not row.failure]
    counts = ", ".join(
        f"{sum(name in row.misses for row in direct)} in {name}"
        for name in ("nonzeros", "memory", "time")
    )
    return f"Direct solves: {len(direct)}; predictions off: {counts}."


def _number(value: float | None, form: str, scale: float = 1.0) -> str:
    return "" if value is None else form.format(scale * value)


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", help="names of problems, separated by commas")
    parser.add_argument("--threads", type=int, default=2, help="threads of a solve (default: 2)")
    parser.add_argument("--repeat", type=int, default=3, help="solves of each (default: 3)")
    parser.add_argument("--json", type=Path, help="also write the rows here")
    return parser.parse_args()


def main() -> int:
    """Measure and print; 1 if a prediction of a direct solver is off."""
    options = arguments()
    scenes = [scene for scene in synthetic.SCENES if scene.name in SYNTHETIC]
    known = problems.find(problems.data_folder()) + [synthetic.problem(scene) for scene in scenes]
    wanted = options.only.split(",") if options.only else [problem.name for problem in known]
    rows: list[Row] = []
    calibration = ask({"do": "calibrate", "threads": options.threads}, options.threads)
    if calibration.get("failure"):
        print(f"calibration: {calibration['failure']}", file=sys.stderr)
        return 2
    print(HEAD)
    for problem in known:
        if problem.name not in wanted:
            continue
        if problem.is_synthetic:
            synthetic.ensure(problem)
        found = rows_of(problem, options.threads, options.repeat)
        print(*map(line, found), sep="\n", flush=True)
        rows += found
    print(f"\n{verdict(rows)}")
    if options.json is not None:
        options.json.write_text(json.dumps([vars(row) for row in rows], indent=1))
    return int(any(row.misses for row in rows))


if __name__ == "__main__":
    sys.exit(main())
