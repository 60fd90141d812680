"""Costs per iteration of `mpirun -n N bundle refine` beside those of one process.

python -m tests.campaigns.rank_costs [--ranks 1,2,3,4] [--only NAME,...]

Of each data set, solver and strategy: steps, and the largest relative difference of a cost of the
divided runs, of steps that were taken and of tries that were rejected, which may be far away; the
number of steps and conjugate gradients is compared, too. Data: what the issue of the divided solves
names, and streets and photo collections of a thousand images.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.solving.ranks.mpirun import mpirun_command

REPOSITORY = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("BUNDLE_DATA", REPOSITORY.parent / "shared" / "data"))

REAL = {
    "16-22106": "bal/problem-16-22106-pre.txt.bz2",
    "vr_opencv": "colmap/vr_opencv",
    "kitti26_stereo_rig": "rigs/kitti26_stereo_rig",
}
PRIORS = ["--set", "cameras *: f prior 2 %"]
SCENES = {
    "street-1000": ["--scene", "street", "--loop-closure"],
    "photo-collection-1000": ["--scene", "photo-collection"],
}
SIZE = ["--images", "1000", "--points", "165000", "--cameras", "individual"]
PRECONDITIONERS = (
    *("two-level", "schur-jacobi", "jacobi", "identity"),
    "schur-power-series-expansion",
)
METHODS = {
    **{name: ["--solver", name] for name in ("dense-schur", "sparse-schur")},
    **{
        f"cg {of}": ["--solver", "iterative-schur", "--preconditioner", of]
        for of in PRECONDITIONERS
    },
    **{
        f"{name} {strategy}": ["--solver", name, "--trust-region", strategy]
        for name in ("dense-schur", "sparse-schur")
        for strategy in ("dogleg", "subspace-dogleg")
    },
}


@dataclass(frozen=True)
class Row:
    """One data set by one method on several processes, beside one process."""

    data: str
    method: str
    num_ranks: int
    num_steps: int
    same_steps: bool
    same_iterations: bool
    largest: float
    largest_rejected: float

    def __str__(self) -> str:
        """Return a line of the table."""
        steps = "same" if self.same_steps else "OTHER"
        of_solver = "same" if self.same_iterations else "other"
        return (
            f"{self.data:22} {self.method:31} N = {self.num_ranks}  {self.num_steps:3d} steps "
            f"{steps:5}  iterations {of_solver:5}  {self.largest:.1e}  "
            f"rejected {self.largest_rejected:.1e}"
        )


def campaign(inputs: dict[str, tuple[Path, list[str]]], ranks: list[int], most: int) -> list[Row]:
    """Run all methods on all inputs; print a row at a time."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="rank-costs-") as name:
        for data, (path, flags) in inputs.items():
            for method, more in METHODS.items():
                words = [str(path), *flags, *more, "--max-iterations", str(most)]
                alone = iterations(Path(name), words, 0)
                for num in ranks:
                    rows.append(
                        compare(data, method, num, alone, iterations(Path(name), words, num))
                    )
                    print(rows[-1], flush=True)
    return rows


def compare(data: str, method: str, num_ranks: int, alone: list[Any], divided: list[Any]) -> Row:
    """Return the row of two runs."""
    successes, counts = (
        [[record[name] for record in run] for run in (alone, divided)]
        for name in ("step_is_successful", "linear_solver_iterations")
    )
    costs = [abs(a["cost"] - b["cost"]) / a["cost"] for a, b in zip(alone, divided, strict=False)]
    taken = [cost for cost, success in zip(costs, successes[0], strict=False) if success]
    rejected = [cost for cost, success in zip(costs, successes[0], strict=False) if not success]
    return Row(
        *(data, method, num_ranks, len(alone) - 1),
        *(successes[0] == successes[1], counts[0] == counts[1]),
        *(max(taken), max(rejected, default=0.0)),
    )


def iterations(folder: Path, words: list[str], num_ranks: int) -> list[Any]:
    """Return the records of a run; 0 processes: one, without mpirun."""
    output = folder / ("out.txt" if ".txt" in words[0] else "out/")
    report = folder / "report.json"
    tail = ["-o", f"{output}{'' if output.suffix else '/'}", "--json", str(report), "--quiet"]
    alone = [sys.executable, "-m", "bundle"]
    head = mpirun_command(num_ranks) if num_ranks else alone
    command = [*head, "refine", *words, *tail]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    found: list[Any] = json.loads(report.read_text())["iterations"]
    return found


def main() -> None:
    """Print the rows, and the largest of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ranks", default="1,2,3,4")
    parser.add_argument("--only", default=",".join([*REAL, *SCENES]))
    parser.add_argument("--max-iterations", type=int, default=20)
    asked = parser.parse_args()
    wanted = asked.only.split(",")
    with tempfile.TemporaryDirectory(prefix="rank-scenes-") as name:
        inputs: dict[str, tuple[Path, list[str]]] = {}
        for data, place in REAL.items():
            if data in wanted:
                inputs[data] = DATA / place, PRIORS if data.startswith("kitti") else []
        for data, options in SCENES.items():
            if data not in wanted:
                continue
            path = Path(name) / f"{data}.txt"
            made = [sys.executable, "-m", "bundle", "synth", str(path), *options, *SIZE, "--quiet"]
            subprocess.run(made, check=True, stdout=subprocess.DEVNULL)
            inputs[data] = path, []
        rows = campaign(inputs, [int(n) for n in asked.ranks.split(",")], asked.max_iterations)
    worst = max(rows, key=lambda row: row.largest)
    others = sum(not row.same_steps for row in rows)
    print(f"{len(rows)} runs, {others} with other steps; largest difference:\n{worst}")


if __name__ == "__main__":
    main()
