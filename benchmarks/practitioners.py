"""Cost of practitioners' inputs per step: position priors, a rig, and a round of filtering.

Each run is a process of its own, ours and pycolmap's in turn, from the same start: the model with
GPS is first put where its positions are, by bundle, disturbed, and written for both. Both minimise
the same cost, over poses, points, focal lengths and distortion: the reprojection error and, with
priors, the squared distance of the camera centres from the positions in standard deviations.
Sensors of a rig are held on it; the gauge is free, or decided by the priors. Of a filter, the time
of ``bundle.filter_observations`` after the solve counts, over that of a step.

Run: python -m benchmarks.practitioners [--repeat N] [--threads N]
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import measure, series, table
from benchmarks.measure import Spread
from benchmarks.problems import ROOT, data_folder

OURS, THEIRS = "bundle", "pycolmap"
SIGMA = 2.0
"""Metres, of each coordinate of a position."""


@dataclass(frozen=True)
class Case:
    """An input, and what is done with it: "priors", "rig" or "filter"."""

    name: str
    what: str
    path: str

    @property
    def title(self) -> str:
        """Return the name of its row."""
        words = {
            "priors": "position priors",
            "rig": "rig, sensors held",
            "filter": "filter over a step",
        }
        return f"{self.name}, {words[self.what]}"


CASES = (
    Case("brighton_gps", "priors", "georeferenced/brighton_gps/model"),
    Case("kitti26_stereo_rig", "rig", "rigs/kitti26_stereo_rig"),
    Case("brighton_gps", "filter", "georeferenced/brighton_gps/model"),
    Case("lund_door", "filter", "colmap/lund_door"),
)


def measured(repeat: int, threads: int, timeout: float) -> dict[str, dict[str, list[Any]]]:
    """Run all cases that there is data for; return runs by title and by whose they are."""
    env = measure.environment(ROOT, threads)
    found: dict[str, dict[str, list[Any]]] = {}
    with tempfile.TemporaryDirectory() as name:
        for case in CASES:
            path = data_folder() / case.path
            if not path.exists():
                continue
            folder = Path(name) / f"{case.name}-{case.what}"
            folder.mkdir()
            request = {"path": str(path), "what": case.what, "threads": threads, **series.STOPPING}
            whose = (OURS,) if case.what == "filter" else (OURS, THEIRS)
            runs: dict[str, list[Any]] = {who: [] for who in whose}
            if case.what == "priors":
                failure = _run({**request, "who": "start"}, folder, env, timeout)["failure"]
                if failure:
                    print(f"{case.title}: not measured: {failure}", file=sys.stderr)
                    continue
            for number in range(repeat):
                for who in whose:
                    run = _run({**request, "who": who}, folder, env, timeout)
                    runs[who].append(run)
                    said = run["failure"] or f"{1e3 * run['step']:.3g} ms a step"
                    print(f"{case.title}: {who}, run {number + 1}: {said}", file=sys.stderr)
            found[case.title] = runs
    return found


def _run(
    request: Mapping[str, Any], folder: Path, env: dict[str, str], timeout: float
) -> dict[str, Any]:
    asked, answered = folder / "request.json", folder / "answer.json"
    asked.write_text(json.dumps({**request, "folder": str(folder)}))
    answered.unlink(missing_ok=True)
    command = [sys.executable, "-m", "benchmarks.runners.practitioner", str(asked), str(answered)]
    child = measure.run_child(command, env, timeout)
    if child.failure:
        return {"failure": child.failure}
    answer: dict[str, Any] = json.loads(answered.read_text())
    return answer


def spread(runs: Sequence[Mapping[str, Any]], what: str) -> Spread | None:
    """Return a quantity over the repeats; None if a run failed or has none."""
    return Spread.of(None if run["failure"] else run.get(what) for run in runs)


def as_table(found: Mapping[str, Mapping[str, Sequence[Mapping[str, Any]]]]) -> str:
    """Return one line a case; "" without any."""
    lines = []
    for title, runs in found.items():
        failures = [run["failure"] for mine in runs.values() for run in mine if run["failure"]]
        if failures:
            lines.append([title, f"no result: {failures[0]}", "", "", "", ""])
            continue
        ours = runs[OURS]
        step = spread(ours, "step")
        line = [title, table.absolute(step), str(ours[-1]["num_steps"])]
        if THEIRS in runs:
            theirs = runs[THEIRS]
            line += [
                table.ratio(spread(theirs, "step"), step),
                table.ratio(spread(theirs, "total"), spread(ours, "total")),
                f"{theirs[-1]['cost'] / ours[-1]['cost'] - 1.0:+.0e}",
            ]
        else:
            line += [table.ratio(spread(ours, "filter"), step), "", ""]
        lines.append(line)
    header = ["input", "bundle, time per step", "steps", "pycolmap, or the filter, per step"]
    return table.grid([*header, "pycolmap, total", "its final cost - 1"], lines) if lines else ""


def main() -> None:
    """Measure, print the table."""
    table.main(__doc__, measured, as_table, repeat=5, timeout=150.0)


if __name__ == "__main__":
    main()
