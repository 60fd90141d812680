"""Pose graphs: bundle's normal equations beside Ceres on the same residual, GTSAM, and g2o.

Prints, for each data set and a synthetic graph of many poses, seconds from the graph in memory to
the refined poses, linear systems solved, and chi2 at the end, whose errors are GTSAM's ("log"), of
g2o its own ("g2o", another optimum). Everybody has one stopping rule, a relative change of the cost
below 1e-6, and starts at the poses of the file, in ``FROM_CHORDAL`` and the synthetic graph at the
chordal start, because GTSAM and g2o end elsewhere from the file. The solvers take turns, each time
in another order, and read the file right before their time; the table has medians.

GTSAM takes the fastest of its Gauss-Newton and Levenberg-Marquardt methods, each by multifrontal
and by sequential Cholesky factorisation, in the order of COLAMD; METIS' was slower on each set. Its
``NonlinearFactorGraph`` is made outside the time, as are bundle's ``PoseGraph``, without what it
prepares for solves, and g2o's ``SparseOptimizer``. Ceres gets bundle's analytic Jacobians and a
radius of 1e16, which makes its steps those of Gauss-Newton. g2o (PyPI: g2opy, by g2o's author)
takes Gauss-Newton with Eigen's sparse Cholesky, in the order of blocks; its wheels have no CHOLMOD.

Run: OPENBLAS_NUM_THREADS=1 python -m benchmarks.pose_graphs [--threads N] [--only NAME,...]
[--repeat N] [--poses N] [--no-synthetic] [--json FILE]
"""

from __future__ import annotations

import argparse
import bz2
import itertools
import os
import random
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import bundle
from benchmarks import backend, measure
from benchmarks.backend import CERES, G2O, GTSAM, MANY, OURS

DATA = Path(os.environ.get("BUNDLE_DATA", Path(__file__).parents[2] / "shared" / "data")) / "g2o"
SETS = ("smallGrid3D", "parking-garage", "sphere2500", "intel", "M3500", "CSAIL", "MIT")
METHODS = ("MULTIFRONTAL_CHOLESKY", "SEQUENTIAL_CHOLESKY")
TOLERANCE = 1e-6
SAME_END = 1e-3
"""Relative difference of chi2 between methods that end at one minimum."""
MOST_STEPS = 100
FROM_CHORDAL = ("MIT",)
"""Sets on which GTSAM and g2o have no result from the poses of the file."""


class Measured(NamedTuple):
    """Measurements of one solve."""

    seconds: float
    solves: int
    chi2: float


def by_bundle(backend: str, threads: int) -> Callable[[Path], Measured]:
    """Return a solve by one of bundle's backends."""

    def run(path: Path) -> Measured:
        graph = bundle.load(path)
        start = time.perf_counter()
        result = bundle.solve(
            graph,
            backend=backend,
            num_threads=threads,
            trust_region_strategy_type="gauss_newton",
            function_tolerance=TOLERANCE,
        )
        took = time.perf_counter() - start
        summary = result.summary
        return Measured(took, summary.num_linear_solves, summary.chi2_final)

    return run


def by_gtsam(path: Path) -> Measured:
    """Solve by the fastest method of GTSAM that reaches its least chi2.

    A strong prior holds the first pose.
    """
    import gtsam

    text = path.read_text()
    space = "SE3" in text
    factors, values = gtsam.readG2o(str(path), space)
    first = min(values.keys())
    kind = gtsam.Pose3 if space else gtsam.Pose2
    noise = gtsam.noiseModel.Isotropic.Variance(6 if space else 3, 1e-12)
    factor: Any = gtsam.PriorFactorPose3 if space else gtsam.PriorFactorPose2
    held = getattr(values, f"at{kind.__name__}")(first)
    factors.add(factor(first, held, noise))
    runs = []
    for name, method in itertools.product(("GaussNewton", "LevenbergMarquardt"), METHODS):
        parameters = getattr(gtsam, f"{name}Params")()
        parameters.setRelativeErrorTol(TOLERANCE)
        parameters.setAbsoluteErrorTol(0)
        parameters.setLinearSolverType(method)
        start = time.perf_counter()
        optimizer = getattr(gtsam, f"{name}Optimizer")(factors, values, parameters)
        try:
            solved = optimizer.optimize()
        except RuntimeError:  # an indeterminate linear system
            continue
        took = time.perf_counter() - start
        runs.append(Measured(took, optimizer.iterations(), 2 * factors.error(solved)))
    if not runs:
        raise RuntimeError("GTSAM: all methods end at an indeterminate linear system")
    least = min(run.chi2 for run in runs)
    return min(run for run in runs if run.chi2 <= (1 + SAME_END) * least)


def by_g2o(path: Path) -> Measured:
    """Solve by g2o's Gauss-Newton, the first pose fixed; the errors are g2o's."""
    import g2opy

    kind = "SE3" if "SE3" in path.read_text() else "SE2"
    linear = getattr(g2opy, f"LinearSolverEigen{kind}")()
    linear.set_block_ordering(True)
    optimizer = g2opy.SparseOptimizer()
    optimizer.set_algorithm(
        g2opy.OptimizationAlgorithmGaussNewton(getattr(g2opy, f"BlockSolver{kind}")(linear))
    )
    optimizer.load(str(path))
    vertices = optimizer.vertices()
    vertices[min(vertices)].set_fixed(True)
    stop = g2opy.SparseOptimizerTerminateAction()
    stop.set_gain_threshold(TOLERANCE)
    stop.set_max_iterations(MOST_STEPS)
    optimizer.add_post_iteration_action(stop)
    start = time.perf_counter()
    optimizer.initialize_optimization()
    steps = optimizer.optimize(MOST_STEPS)
    took = time.perf_counter() - start
    optimizer.compute_active_errors()
    return Measured(took, steps, optimizer.active_chi2())


def many_poses(count: int, seed: int = 0) -> bundle.PoseGraph:
    """Return a walk through a city of blocks in the plane, with closures between near places."""
    rng = np.random.default_rng(seed)
    side = max(int(np.sqrt(count / 8)), 4)
    heading, place, truth = 0, np.zeros(2), []
    for _ in range(count):
        truth.append([*place, heading * np.pi / 2])
        step = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[heading % 4]
        if rng.random() < 0.2 or np.abs(place + step).max() > side / 2:
            heading += int(rng.choice([-1, 1]))
        else:
            place = place + step
    poses = np.array(truth)
    order = np.lexsort((poses[:, 1], poses[:, 0]))
    same = np.flatnonzero((poses[order[1:], :2] == poses[order[:-1], :2]).all(axis=1))
    pairs = np.sort(np.stack([order[same], order[same + 1]], axis=1), axis=1)
    pairs = pairs[pairs[:, 1] - pairs[:, 0] > 10]
    pairs = pairs[rng.permutation(len(pairs))[: count // 5]]
    edges = np.concatenate([np.stack([np.arange(count - 1), np.arange(1, count)], 1), pairs])
    first, second = poses[edges[:, 0]], poses[edges[:, 1]]
    c, s = np.cos(first[:, 2]), np.sin(first[:, 2])
    apart = second - first
    relative = np.stack(
        [c * apart[:, 0] + s * apart[:, 1], c * apart[:, 1] - s * apart[:, 0], apart[:, 2]], 1
    )
    measured = relative + rng.normal(0, [0.02, 0.02, 0.002], relative.shape)
    information = np.tile(np.diag([2500.0, 2500, 250000]), (len(edges), 1, 1))
    return bundle.PoseGraph(
        poses=poses, edges=edges, measurements=measured, information=information
    )


def measured(
    names: Sequence[str], repeats: int, threads: int, poses: int
) -> dict[str, dict[str, list[dict[str, float]]]]:
    """Return the runs by data set and solver; a solver that fails on a set has none there."""
    solvers = {
        OURS: by_bundle("fused", threads),
        CERES: by_bundle("ceres", threads),
        GTSAM: by_gtsam,
        G2O: by_g2o,
    }
    found: dict[str, dict[str, list[dict[str, float]]]] = {}
    for name in names:
        source = DATA / f"{name}.g2o.bz2"
        if name != MANY and not source.exists():
            continue
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{name}.g2o"
            if name == MANY:
                graph = many_poses(poses)
            else:
                path.write_bytes(bz2.decompress(source.read_bytes()))
                graph = bundle.load(path)
            if name == MANY or name in FROM_CHORDAL:
                graph = graph.replace(poses=bundle.initial_poses(graph, "chordal"))
            bundle.save(graph, path)
            runs: dict[str, list[dict[str, float]]] = {solver: [] for solver in solvers}
            turns = random.Random(0)
            for _ in range(repeats):
                for solver in turns.sample(list(solvers), len(solvers)):
                    try:
                        runs[solver].append(solvers[solver](path)._asdict())
                    except (ImportError, RuntimeError) as error:
                        print(f"{name}: {solver}: {str(error).splitlines()[0]}", file=sys.stderr)
            found[name] = runs
    if not found:
        print(f"No data set in {DATA}: set BUNDLE_DATA.", file=sys.stderr)
    return found


def main() -> None:
    """Measure, print the table, and write the runs with --json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--only", default=",".join((*SETS, MANY)))
    parser.add_argument("--poses", type=int, default=100_000, help="of the synthetic graph")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all runs there")
    parser.add_argument("--no-synthetic", action="store_true", help="without that graph")
    given = parser.parse_args()
    names = [n for n in given.only.split(",") if n != MANY or not given.no_synthetic]
    found = measured(names, given.repeat, given.threads, given.poses)
    measure.answer(found, backend.graphs_table(found), given.json)


if __name__ == "__main__":
    main()
