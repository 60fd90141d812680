"""Time that a solver object spends outside its steps.

Prints, for solves of one structure again and again, the wall time of ``Solver.solve`` over the
time inside steps: for a BAL problem of the data folder and for a synthetic one of 500 observations,
with and without the checks at the end, beside what ``bundle.solve`` needs. The variants take turns;
every solve starts from the same values, given as arrays of their own.

The time inside steps is the sum of ``result.iterations["iteration_time_in_seconds"]``. A step that
meets a tolerance may leave no record there; so that all are counted, each solve has the number of
steps that the default tolerances allow, and no tolerance.

Run: python -m benchmarks.repeated [--threads N]
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import bundle
from benchmarks.problems import data_folder

Solve = Callable[[bundle.Problem], bundle.Result]


def copies(problem: bundle.Problem, count: int) -> list[bundle.Problem]:
    """Return problems with the same values in arrays of their own."""
    return [
        problem.replace(points=np.array(problem.points), observation_xy=problem.observation_xy + 0)
        for _ in range(count)
    ]


def all_steps(problem: bundle.Problem) -> dict[str, float]:
    """Return options for the steps of a solve with the default tolerances, each on record."""
    steps = bundle.solve(problem).summary.num_linear_solves
    tolerances = dict.fromkeys(
        ("function_tolerance", "gradient_tolerance", "parameter_tolerance"), 0.0
    )
    return {"max_num_iterations": steps, **tolerances}


def timed(solve: Solve, problems: list[bundle.Problem]) -> tuple[float, float]:
    """Return the wall time of solving the problems and the part of it inside steps."""
    start = time.perf_counter()
    results = [solve(problem) for problem in problems]
    wall = time.perf_counter() - start
    times = [result.iterations["iteration_time_in_seconds"] for result in results]
    return wall, float(np.concatenate(times).sum())


def compare(problem: bundle.Problem, name: str, *, count: int, rounds: int, threads: int) -> None:
    """Print the ratios of the variants, medians of the rounds."""
    options: dict[str, Any] = {"num_threads": threads, **all_steps(problem)}
    solver = bundle.Solver(problem, **options)
    unchecked = bundle.Solver(problem, check_solution=False, **options)
    variants: dict[str, Solve] = {
        "Solver, check_solution=False": unchecked.solve,
        "Solver": solver.solve,
        "bundle.solve": lambda p: bundle.solve(p, **options),
    }
    problems = copies(problem, count)
    times: dict[str, list[tuple[float, float]]] = {variant: [] for variant in variants}
    for _ in range(rounds):
        for variant, solve in variants.items():
            times[variant].append(timed(solve, problems))
    print(
        f"{name}: {problem.num_observations} observations, {options['max_num_iterations']} steps, "
        f"{count} solves, {rounds} rounds"
    )
    for variant, measured in times.items():
        ratios = sorted(wall / inside for wall, inside in measured)
        wall, inside = (
            1e3 / count * statistics.median(column) for column in zip(*measured, strict=True)
        )
        print(
            f"  {variant:<29} {statistics.median(ratios):.3f} times the time inside steps "
            f"({ratios[0]:.3f} to {ratios[-1]:.3f}), {wall:.2f} ms of which {inside:.2f} inside"
        )


def main() -> None:
    """Measure both problems."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=0)
    threads = parser.parse_args().threads
    small = bundle.synthesize(num_images=10, num_points=115, mean_track_length=5, seed=1).problem
    compare(small, "synthetic", count=1000, rounds=3, threads=threads)
    for path in sorted((data_folder() / "bal").glob("*16-22106*")):
        compare(bundle.load(path), path.name, count=2, rounds=7, threads=threads)


if __name__ == "__main__":
    main()
