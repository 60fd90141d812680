"""Seconds of COLMAP's incremental mapper with bundle's adjuster, and with its own.

    python benchmarks/mapping.py [--images 40,100] [--repeat 3] [--json FILE]

A synthetic database of COLMAP (exhaustive matches, 95 % of them right) is mapped by three arms in
processes of their own, in turns:

- bundle: examples/faster_mapping/faster_mapping.py;
- pycolmap in Python: the same file, with pycolmap's adjusters in the place of bundle's;
- pycolmap: ``pycolmap.incremental_mapping``, whose adjustments cannot be timed apart.

CPU seconds hardly depend on the load of the machine; wall seconds do. Medians of the repeats. The
whole time includes the reading of the database, but not start and imports.
"""

from __future__ import annotations

import argparse
import json
import runpy
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pycolmap

import bundle

EXAMPLE = Path(__file__).parents[1] / "examples" / "faster_mapping" / "faster_mapping.py"
ARMS = ("bundle", "pycolmap in Python", "pycolmap")


def synthesize(folder: Path, num_images: int) -> None:
    """Write a database with 30 points per image, each seen by 20 images on average."""
    pycolmap.set_random_seed(3)
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1, num_cameras_per_rig=1, num_frames_per_rig=num_images,
        num_points3D=30 * num_images, track_length=min(20, num_images), inlier_match_ratio=0.95,
    )  # fmt: skip
    with pycolmap.Database.open(folder / "database.db") as database:
        made = pycolmap.synthesize_dataset(options, database)
        noise = pycolmap.SyntheticNoiseOptions(point2D_stddev=0.7)
        pycolmap.synthesize_noise(noise, made, database)


class Adjuster:
    """An adjuster that measures its time."""

    def __init__(self, adjust: Any) -> None:
        self.adjust, self.calls, self.wall, self.cpu = adjust, 0, 0.0, 0.0

    def __call__(self, *arguments: Any) -> Any:
        wall, cpu = time.perf_counter(), time.process_time()
        summary = self.adjust(*arguments)
        self.calls += 1
        self.wall += time.perf_counter() - wall
        self.cpu += time.process_time() - cpu
        return summary


def adjust_by_pycolmap(model: Any, options: Any, config: Any = None) -> Any:
    """Adjust as the example asks bundle to."""
    if config is None:
        return pycolmap.bundle_adjustment(model, options)
    return pycolmap.create_default_bundle_adjuster(options, config, model).solve()


def run_arm(arm: str, folder: Path) -> dict[str, Any]:
    """Map the database in this process; return times and the size of the model."""
    pycolmap.logging.minloglevel = 2
    adjuster = Adjuster(bundle.bundle_adjustment if arm == "bundle" else adjust_by_pycolmap)
    wall, cpu = time.perf_counter(), time.process_time()
    if arm == "pycolmap":
        options = pycolmap.IncrementalPipelineOptions(
            random_seed=0, multiple_models=False, extract_colors=False
        )
        database, output = folder / "database.db", folder / "mapped"
        output.mkdir(exist_ok=True)
        model = pycolmap.incremental_mapping(database, folder, output, options)[0]
    else:
        vars(bundle)["bundle_adjustment"] = adjuster  # the example looks it up at each call
        sys.argv = [str(EXAMPLE), str(folder / "database.db"), str(folder / "sparse")]
        model = runpy.run_path(str(EXAMPLE), run_name="__main__")["model"]
    return {
        "arm": arm,
        "wall": time.perf_counter() - wall,
        "cpu": time.process_time() - cpu,
        "calls": adjuster.calls,
        "adjust_wall": adjuster.wall,
        "adjust_cpu": adjuster.cpu,
        "images": model.num_reg_images(),
        "points": model.num_points3D(),
        "observations": model.compute_num_observations(),
        "error": model.compute_mean_reprojection_error(),
    }


def measure(num_images: int, repeat: int) -> list[dict[str, Any]]:
    """Return one row per arm: medians of times, and the model of the last run."""
    runs: dict[str, list[dict[str, Any]]] = {arm: [] for arm in ARMS}
    with tempfile.TemporaryDirectory(prefix="bundle-mapping-") as folder:
        synthesize(Path(folder), num_images)
        for _ in range(repeat):
            for arm in ARMS:
                words = [sys.executable, __file__, "--arm", arm, "--folder", folder]
                done = subprocess.run(words, check=True, capture_output=True, text=True)
                runs[arm].append(json.loads(done.stdout.splitlines()[-1]))
    times = ("wall", "cpu", "adjust_wall", "adjust_cpu")
    return [
        of_arm[-1] | {name: statistics.median(one[name] for one in of_arm) for name in times}
        for of_arm in runs.values()
    ]


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--images", default="40,100", help="sizes of the scenes")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--json", help="file for all rows")
    parser.add_argument("--arm", choices=ARMS, help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.arm:
        print(json.dumps(run_arm(given.arm, given.folder)))
        return
    rows = []
    print("| images | mapper | adjustments | their CPU [s] | CPU [s] | wall [s] | points | "
          "observations | error [px] |\n|---|---|---|---|---|---|---|---|---|")  # fmt: skip
    for num_images in map(int, given.images.split(",")):
        for row in measure(num_images, given.repeat):
            rows.append(row)
            adjusted = f"{row['calls']} | {row['adjust_cpu']:.2f}" if row["calls"] else "- | -"
            print(
                f"| {row['images']} | {row['arm']} | {adjusted} | {row['cpu']:.2f} | "
                f"{row['wall']:.2f} | {row['points']:,} | {row['observations']:,} | "
                f"{row['error']:.5f} |",
                flush=True,
            )
    if given.json:
        Path(given.json).write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
