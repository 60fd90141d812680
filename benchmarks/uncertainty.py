"""Cost of covariances and of diagnosis.

Each run is a process of its own, ours and pycolmap's in turn, of the same model as it stands. Ours
computes marginal covariances of all images, cameras and points, under inner constraints and with
two cameras held; pycolmap's ``estimate_ba_covariance`` of ALL holds two cameras, and its points are
conditional: they hold the images. Times are of the call alone. Both are given the same threads, of
which pycolmap uses one: wall times differ by more than CPU times do. A drive of 5000 images has no
peer, whose memory does not suffice; its diagnosis counts too. It has one camera: with a lens for
each image, nothing holds such a drive one way but noise, and the normal equations have no digits
left for its covariance, which is refused. The CPU time of the reliability of all observations is to
be compared with that of the covariance of all poses.

Run: python -m benchmarks.uncertainty [--repeat N] [--threads N] [--timeout SECONDS]
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import measure, table
from benchmarks.measure import Spread
from benchmarks.problems import ROOT, data_folder

INNER, TWO_CAMERAS, DIAGNOSIS, THEIRS = (
    "bundle inner",
    "bundle two-cameras",
    "bundle diagnosis",
    "pycolmap",
)
POSES, RELIABILITY, INFLUENCE = "bundle poses", "bundle reliability", "bundle influence"
STREET: dict[str, Any] = {
    "scene": "street",
    "num_images": 1000,
    "num_points": 60_000,
    "mean_track_length": 6.0,
}
STREET_NAME, LARGE_NAME = "street of 1000 images", "street of 5000 images"
LARGE: dict[str, Any] = {
    "scene": "street",
    "num_images": 5000,
    "num_points": 1_000_000,
    "mean_track_length": 5.0,
}
STREETS = {STREET_NAME: STREET, LARGE_NAME: LARGE}

Runs = Mapping[str, Sequence[Mapping[str, Any]]]


@dataclass(frozen=True)
class Case:
    """A model, and who runs on it. Without a path it is made."""

    name: str
    path: str
    who: tuple[str, ...]


CASES = (
    Case("lund_door", "colmap/lund_door", (INNER, TWO_CAMERAS, THEIRS)),
    Case(STREET_NAME, "", (INNER, TWO_CAMERAS, THEIRS)),
    Case("lund_door, analyses", "colmap/lund_door", (POSES, RELIABILITY, INFLUENCE)),
    Case("vr_opencv, analyses", "colmap/vr_opencv", (POSES, RELIABILITY, INFLUENCE)),
    Case(LARGE_NAME, "", (INNER, DIAGNOSIS)),
)


def measured(repeat: int, threads: int, timeout: float) -> dict[str, dict[str, list[Any]]]:
    """Run all cases that there is data for; return runs by case and by whose they are."""
    env = measure.environment(ROOT, threads)
    found: dict[str, dict[str, list[Any]]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case in CASES:
            path = data_folder() / case.path if case.path else folder / case.name
            if not case.path:
                request = {"who": "make", "path": str(path), "threads": threads}
                made = _run(request | {"scene": STREETS[case.name]}, folder, env, 600)
                if made["failure"]:
                    print(f"{case.name}: not measured: {made['failure']}", file=sys.stderr)
                    continue
            if not path.exists():
                continue
            runs: dict[str, list[Any]] = {who: [] for who in case.who}
            for number in range(repeat):
                for who in case.who:
                    request = {"who": who, "path": str(path), "threads": threads}
                    run = _run(request, folder, env, timeout)
                    runs[who].append(run)
                    said = run["failure"] or f"{run['cpu']:.3g} s of CPU time"
                    print(f"{case.name}: {who}, run {number + 1}: {said}", file=sys.stderr)
            found[case.name] = runs
    return found


def _run(
    request: Mapping[str, Any], folder: Path, env: dict[str, str], timeout: float
) -> dict[str, Any]:
    asked, answered = folder / "request.json", folder / "answer.json"
    asked.write_text(json.dumps(request))
    answered.unlink(missing_ok=True)
    command = [sys.executable, "-m", "benchmarks.runners.uncertainty", str(asked), str(answered)]
    child = measure.run_child(command, env, timeout)
    if child.failure:
        return {"failure": child.failure}
    answer: dict[str, Any] = json.loads(answered.read_text())
    return answer


def spread(runs: Sequence[Mapping[str, Any]], what: str) -> Spread | None:
    """Return a quantity over the repeats; None if a run failed or has none."""
    return Spread.of(None if run["failure"] else run.get(what) for run in runs)


def as_table(found: Mapping[str, Runs]) -> str:
    """Return one line a case and computation; "" without any."""
    lines = []
    for name, runs in found.items():
        for who, mine in runs.items():
            if who == THEIRS:
                continue
            failures = [run["failure"] for run in mine if run["failure"]]
            if failures:
                lines.append([name, who, f"no result: {failures[0]}", "", "", "", "", ""])
                continue
            line = [name, who, *(table.absolute(spread(mine, what)) for what in ("cpu", "wall"))]
            memory = spread(mine, "memory")
            line.append(table.megabytes(memory.median) if memory else "")
            if THEIRS in runs:
                theirs = runs[THEIRS]
                line += [
                    table.ratio(spread(theirs, what), spread(mine, what), missing="no result")
                    for what in ("wall", "cpu")
                ]
                line.append(
                    table.ratio(
                        spread(theirs, "memory"), memory, table.megabytes, missing="no result"
                    )
                )
            else:
                line += ["", "", ""]
            lines.append(line)
    header = ["model", "computation", "CPU time", "wall time", "peak memory"]
    header += ["pycolmap, wall time", "pycolmap, CPU time", "pycolmap, memory"]
    return table.grid(header, lines) if lines else ""


def main() -> None:
    """Measure, print the table."""
    table.main(__doc__, measured, as_table, repeat=5, timeout=300.0)


if __name__ == "__main__":
    main()
