"""Time of `bundle validate` with its default candidates: whole processes, start to exit.

Nine candidates are fitted to all observations and without each of five folds, 54 solves in all. The
photographs of `vr_opencv` and `lund_door` are real. The orbit of 128 photographs is synthetic, with
one lens and 1 % of gross outliers.

Run: python -m benchmarks.judging [--repeat N] [--threads N] [--timeout SECONDS]
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import measure, table
from benchmarks.measure import Spread
from benchmarks.problems import ROOT, data_folder
from benchmarks.whole import COMMAND

LIMIT = 20.0
"""Seconds."""

SYNTHETIC = "128 photographs"
SCENE = (
    *("--scene", "orbit", "--images", "128", "--points", "8000", "--seed", "4"),
    *("--track-length", "6", "--outlier-share", "0.01"),
)
REAL = {"vr_opencv": "colmap/vr_opencv", "lund_door": "colmap/lund_door"}

Runs = Mapping[str, Sequence[Mapping[str, Any]]]


def measured(repeat: int, threads: int, timeout: float) -> dict[str, list[dict[str, Any]]]:
    """Run all cases that there is data for; return runs by name."""
    env = measure.environment(ROOT, 1)  # OpenBLAS'; bundle is told its own
    found: dict[str, list[dict[str, Any]]] = {}
    with tempfile.TemporaryDirectory() as name:
        made = Path(name) / "made"
        bundle = [sys.executable, "-c", COMMAND]
        subprocess.run([*bundle, "synth", str(made), *SCENE, "--quiet"], check=True, env=env)
        paths = {SYNTHETIC: made, **{key: data_folder() / path for key, path in REAL.items()}}
        answer = Path(name) / "answer.json"
        for title, path in paths.items():
            if not path.exists():
                continue
            command = [*bundle, "validate", str(path), "--quiet", "--threads", str(threads)]
            for number in range(repeat):
                answer.unlink(missing_ok=True)
                child = measure.run_child([*command, "--json", str(answer)], env, timeout)
                run = {"failure": child.failure, "wall": child.wall, "cpu": child.cpu}
                if not child.failure:
                    said = json.loads(answer.read_text())
                    counts = {key: said["input"][key] for key in ("num_images", "num_observations")}
                    run |= {"num_candidates": len(said["candidates"]), **counts}
                found.setdefault(title, []).append(run)
                words = child.failure or f"{child.wall:.3g} s"
                print(f"validate {title}, run {number + 1}: {words}", file=sys.stderr)
    return found


def spread(runs: Sequence[Mapping[str, Any]], what: str) -> Spread | None:
    """Return a quantity over the repeats; None if a run failed."""
    return Spread.of(None if run["failure"] else run.get(what) for run in runs)


def as_table(found: Runs) -> str:
    """Return one line per input; "" without any."""
    lines = []
    for title, runs in found.items():
        last = runs[-1]
        if any(run["failure"] for run in runs):
            failures = [run["failure"] for run in runs if run["failure"]]
            lines.append([title, f"no result: {failures[0]}", "", "", ""])
            continue
        counts = f"{last['num_images']} images, {last['num_observations']:,} observations"
        times = [table.absolute(spread(runs, what)) for what in ("wall", "cpu")]
        lines.append([title, counts, str(last["num_candidates"]), *times])
    header = ["input", "size", "candidates", "wall time", "CPU time"]
    return table.grid(header, lines) if lines else ""


def main() -> None:
    """Measure, print the table."""
    table.main(__doc__, measured, as_table, repeat=3, timeout=150.0)


if __name__ == "__main__":
    main()
