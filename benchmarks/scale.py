"""One large problem from file to file: made by `bundle synth`, refined by `bundle refine`.

A drive one way through streets with tracks of 6 observations, every image with a camera of its own,
as BAL files have it. Each command is a process of its own, whose peak memory is the kernel's
(ru_maxrss). The start is near the truth, so that a few steps do (`benchmarks/synthetic.py`).

Rows that are to stay go into `large_problems.md`, of which `run.py` makes a section of its page.

On disk are, in turn, the scene with its ground truth, and the scene with the refined file: up to
130 bytes an observation. In memory are some 80 bytes an observation, 27 kB an image of S with its
factor, and 115 MB of the program, its threads and OpenBLAS.

Run: python -m benchmarks.scale --observations 20e6 [--max-steps 3] [--folder DIR] [--keep]
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import table
from benchmarks.measure import Child, environment, run_child
from benchmarks.problems import ROOT
from benchmarks.synthetic import NEAR_START
from benchmarks.whole import COMMAND

TRACK_LENGTH = 6
MOST_PER_IMAGE = 10_000
"""Observations of an image in the largest problems; there are 2000 in those of 20 million."""
BYTES_ON_DISK = 130
_TIMEOUT = 24 * 3600.0
HEADER = (
    "observations",
    "images",
    "synth",
    "its memory",
    "refine",
    "load",
    "solve",
    "a step",
    "save",
    "statistics",
    "the rest",
    "its memory",
    "bytes an observation",
    "RMSE [px]",
)


def measured() -> str:
    """Return the section with the rows that are kept."""
    return (ROOT / "benchmarks" / "large_problems.md").read_text().rstrip()


def num_images(num_observations: int) -> int:
    """Return the images of a problem: 2000 observations each, more beyond 20 million."""
    return max(10, num_observations // MOST_PER_IMAGE, min(num_observations // 2000, 10_000))


def synth_arguments(num_observations: int, path: Path, truth: Path) -> list[str]:
    """Return the arguments of `bundle synth`."""
    settings = {
        "--scene": "street",
        "--images": num_images(num_observations),
        "--points": num_observations // TRACK_LENGTH,
        "--track-length": TRACK_LENGTH,
        "--camera-model": "RADIAL",
        "--cameras": "individual",
        "--seed": 4,
        "--ground-truth": truth,
        **{f"--{name.replace('_', '-')}": value for name, value in NEAR_START.items()},
    }
    flags = [str(word) for pair in settings.items() for word in pair]
    return ["synth", str(path), *flags, "--no-loop-closure", "--quiet"]


def refine_arguments(path: Path, output: Path, report: Path, max_steps: int) -> list[str]:
    """Return the arguments of `bundle refine`."""
    files = [str(path), "-o", str(output), "--json", str(report)]
    return ["refine", *files, "--max-iterations", str(max_steps), "--quiet"]


def row(num_observations: int, synth: Child, refine: Child, report: dict[str, Any]) -> list[str]:
    """Return the cells of a measured problem, of HEADER."""
    time, errors = report["wall_time"], report["reprojection_error"]
    named = ("load", "build", "solve", "save", "statistics")
    steps = max(len(report["iterations"]) - 1, 1)
    per_step = report["summary"]["minimizer_time_in_seconds"] / steps
    return [
        f"{num_observations:,}",
        f"{num_images(num_observations):,}",
        table.seconds(synth.wall),
        f"{synth.peak_memory / 1e9:.2f} GB",
        table.seconds(refine.wall),
        table.seconds(time["load"]),
        table.seconds(time["solve"]),
        table.seconds(per_step),
        table.seconds(time["save"]),
        table.seconds(time["statistics"]),
        table.seconds(refine.wall - sum(time[name] for name in named)),
        f"{refine.peak_memory / 1e9:.2f} GB",
        f"{refine.peak_memory / num_observations:.1f}",
        f"{errors['before']['rmse']:.3f} to {errors['after']['rmse']:.3f}",
    ]


def measure(num_observations: int, max_steps: int, folder: Path, *, keep: bool) -> list[str]:
    """Make, refine and measure a problem.

    Raises:
        RuntimeError: a command failed, or the disk is too small.
    """
    refuse_small_disk(folder, BYTES_ON_DISK * num_observations)
    names = ("scene.txt", "truth.txt", "refined.txt", "report.json")
    scene, truth, refined, report = (folder / name for name in names)
    made = run_command(synth_arguments(num_observations, scene, truth))
    truth.unlink()
    print(f"made in {made.wall:.0f} s, {made.peak_memory / 1e9:.2f} GB", file=sys.stderr)
    done = run_command(refine_arguments(scene, refined, report, max_steps))
    cells = row(num_observations, made, done, json.loads(report.read_text()))
    if not keep:
        for path in (scene, refined, report):
            path.unlink()
    return cells


def refuse_small_disk(folder: Path, wanted: int) -> None:
    """Raise a RuntimeError if the files do not fit."""
    if (free := shutil.disk_usage(folder).free) < wanted:
        raise RuntimeError(f"expected {wanted / 1e9:.1f} GB of disk, found {free / 1e9:.1f} GB")


def run_command(arguments: Sequence[str]) -> Child:
    """Run the command line.

    Raises:
        RuntimeError: it failed.
    """
    command = [sys.executable, "-c", COMMAND, *arguments]
    child = run_child(command, environment(ROOT, None), _TIMEOUT)
    if child.failure:
        raise RuntimeError(f"bundle {arguments[0]}: {child.failure}")
    return child


def main() -> int:
    """Measure and print the row."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--observations", type=float, required=True, metavar="N")
    parser.add_argument("--max-steps", type=int, default=3, metavar="N")
    parser.add_argument("--folder", type=Path, help="where files go (default: a temporary one)")
    parser.add_argument("--keep", action="store_true", help="leave the files there")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=given.folder) as temporary:
        folder = given.folder if given.keep and given.folder else Path(temporary)
        try:
            cells = measure(int(given.observations), given.max_steps, folder, keep=given.keep)
        except RuntimeError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
    print(table.grid(list(HEADER), [cells]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
