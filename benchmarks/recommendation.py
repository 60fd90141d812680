"""Is what is recommended before any solve as good as the best that is measured?

    python benchmarks/recommendation.py                    # everything, an hour or two
    python benchmarks/recommendation.py --only 49-7776,orbit-120
    python benchmarks/recommendation.py --no-ceres         # the fused backend's solvers alone

On every real data set and on synthetic shapes, `bundle.compare` runs its default set. Beside the
least total time of the methods that reach the best cost stand the totals of what it foresaw before
it ran them (`bundle.inspect`'s predictions) and of what `--solver auto` takes. The shapes are not
those that any bound in the code was drawn from (choose_solver.cpp: streets, orbits and collections
of 300 to 4000 images with tracks of 5): they differ in size, in track length and in who shares a
camera.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import bundle
from benchmarks import machine, problems, table
from bundle.planning.comparison.compare_methods import compare
from bundle.planning.comparison.comparison_result import Comparison
from bundle.planning.comparison.measured_run import Method
from bundle.planning.comparison.recommendation import COST_TOLERANCE, NEAR_ENOUGH
from bundle.planning.comparison.work import taken_by_auto

# name: fields of bundle.SceneOptions
SHAPES: dict[str, dict[str, Any]] = {
    "street-30": {"scene": "street", "num_images": 30, "num_points": 6000},
    "street-150-shared": {"scene": "street", "num_images": 150, "num_points": 20_000},
    "street-400": {
        "scene": "street", "num_images": 400, "num_points": 30_000, "cameras": "individual",
    },
    "street-700-short": {
        "scene": "street", "num_images": 700, "num_points": 60_000, "mean_track_length": 3.0,
        "cameras": "individual",
    },
    "street-1500-oneway": {
        "scene": "street", "num_images": 1500, "num_points": 90_000, "loop_closure": False,
        "cameras": "individual",
    },
    "orbit-40-long": {
        "scene": "orbit", "num_images": 40, "num_points": 3000, "mean_track_length": 10.0,
    },
    "orbit-120": {
        "scene": "orbit", "num_images": 120, "num_points": 10_000, "mean_track_length": 8.0,
    },
    "orbit-300-individual": {
        "scene": "orbit", "num_images": 300, "num_points": 20_000, "cameras": "individual",
    },
    "orbit-500": {
        "scene": "orbit", "num_images": 500, "num_points": 20_000, "mean_track_length": 10.0,
    },
    "photo-collection-60": {"scene": "photo_collection", "num_images": 60, "num_points": 8000},
    "photo-collection-250-long": {
        "scene": "photo_collection", "num_images": 250, "num_points": 12_000,
        "mean_track_length": 12.0,
    },
    "photo-collection-700": {
        "scene": "photo_collection", "num_images": 700, "num_points": 50_000,
    },
    "photo-collection-1500-short": {
        "scene": "photo_collection", "num_images": 1500, "num_points": 100_000,
        "mean_track_length": 3.5,
    },
}  # fmt: skip
SEED = 11
HEAD = ("problem", "observations", "S", "best", "total", "foreseen", "ratio", "auto", "ratio")


@dataclass(frozen=True)
class Judged:
    """One problem: times in seconds, NaN for what did not reach the best cost."""

    problem: str
    num_observations: int
    size: str
    best: str
    best_time: float
    foreseen: str
    foreseen_time: float
    auto: str
    auto_time: float

    def row(self) -> list[str]:
        """Return the cells of the table."""
        return [
            self.problem, str(self.num_observations), self.size,
            self.best, table.seconds(self.best_time),
            self.foreseen, f"{self.foreseen_time / self.best_time:.2f}",
            self.auto, f"{self.auto_time / self.best_time:.2f}",
        ]  # fmt: skip


def judge(name: str, problem: bundle.Problem, comparison: Comparison) -> Judged:
    """Return how foreseen and automatic choices compare with the best."""
    times = {
        run.method: run.total_time_in_seconds
        for run in comparison.runs
        if run.is_usable and comparison.gap(run) <= COST_TOLERANCE
    }
    best = min(times, key=lambda method: times[method])
    known = next((run.prediction for run in comparison.runs if run.prediction), None)
    foreseen = comparison.recommendation.foreseen[0] if comparison.recommendation else None
    auto = taken_by_auto(problem, comparison.options, best.num_threads)

    def told(method: Method | None) -> tuple[str, float]:
        return ("-", math.nan) if method is None else (method.name, times.get(method, math.nan))

    size = "-"
    if known is not None:
        full = 100 * known.nnz_reduced / known.num_unknowns**2
        size = f"{known.num_unknowns} columns, {full:.0f} % full"
    return Judged(name, problem.num_observations, size, *told(best), *told(foreseen), *told(auto))


def wanted(names: set[str]) -> Iterator[tuple[str, bundle.Problem]]:
    """Yield the problems by name, real ones first; all of them if no names are given."""
    for real in problems.find(problems.data_folder()):
        if not names or real.name in names:
            yield real.name, bundle.load(real.path)
    for name, fields in SHAPES.items():
        if not names or name in names:
            yield name, bundle.synthesize(**fields, camera_model="RADIAL", seed=SEED).problem


def main() -> None:
    """Measure, print the table, and how many choices were right."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="problems, separated by commas")
    parser.add_argument("--repeat", type=int, default=5, help="runs of which the median counts")
    parser.add_argument("--timeout", type=float, default=60.0, help="seconds of a solve")
    parser.add_argument("--no-ceres", action="store_true", help="the fused backend alone")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    judged = []
    print(", ".join(f"{key}: {value}" for key, value in machine.describe().items()))
    for name, problem in wanted({name for name in arguments.only.split(",") if name}):
        comparison = compare(
            problem,
            backends=("fused",) if arguments.no_ceres else ("fused", "ceres"),
            trust_regions=("levenberg_marquardt",),  # predictions do not depend on it
            repeat=arguments.repeat,
            timeout=arguments.timeout,
        )
        if comparison.interrupted:
            break
        if comparison.recommendation is None:
            print(f"{name}: no method can be recommended", file=sys.stderr)
            continue
        judged.append(judge(name, problem, comparison))
        print("  ".join(judged[-1].row()), file=sys.stderr, flush=True)
        _dump(arguments.json, judged)
    print(table.grid(HEAD, [one.row() for one in judged]))
    for what in ("foreseen", "auto"):
        ratios = [getattr(one, f"{what}_time") / one.best_time for one in judged]
        right = sum(ratio <= NEAR_ENOUGH for ratio in ratios)
        print(f"{what}: within {NEAR_ENOUGH:g} times the best on {right} of {len(judged)}")


def _dump(path: Path | None, judged: list[Judged]) -> None:
    """Write what there is so far: the whole takes long."""
    if path is not None:
        path.write_text(json.dumps([vars(one) for one in judged], indent=2) + "\n")


if __name__ == "__main__":
    main()
