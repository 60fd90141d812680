"""The slow solve of 5,000 poses names its ordering, the fast one and 100 healthy inputs are silent.

python -m tests.campaigns.orderings [POSES LOOPS]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

import bundle
from tests.campaigns.triage_inputs import chain_of_poses, graph_of

Solve = Callable[[], Any]


def slow_and_fast(num_poses: int, num_loops: int) -> dict[str, Any]:
    """Summaries of one graph in several orders."""
    graph = chain_of_poses(0, num_poses, num_loops)
    orders = ("natural", "metis", "amd", "auto")
    return {order: bundle.solve(graph, ordering=order).summary for order in orders}


def healthy() -> Iterator[tuple[str, Solve]]:
    """Yield 100 inputs as users solve them, by name."""
    for seed in range(20):
        loops = 10 + 20 * seed
        graph = chain_of_poses(seed, 100 + 100 * seed, loops)
        order = ("auto", "metis", "amd")[seed % 3]
        yield f"walk {seed} {order}", _solve(graph, ordering=order)
    for seed in range(15):
        graph = grid(seed, 6 + 2 * seed)
        yield f"grid {seed}", _solve(graph, ordering=("auto", "metis", "amd")[seed % 3])
    for seed in range(15):
        yield f"hubs {seed}", _solve(hubs(seed, 200 + 50 * seed, 1 + seed % 4))
    for seed in range(10):
        chain = chain_of_poses(seed, 300 + 300 * seed, 5 + seed, reach=20)
        yield f"odometry in natural order {seed}", _solve(chain, ordering="natural")
    for seed in range(10):
        graph = chain_of_poses(seed, 200 + 100 * seed, 20 * seed)
        yield f"walk by Ceres {seed}", _solve(graph, backend="ceres")
    for seed in range(15):
        yield f"factors {seed}", factors(chain_of_poses(seed, 60 + 20 * seed, 10 + seed)).solve
    scenes = ("orbit", "street", "photo_collection")
    for seed in range(15):
        problem = bundle.synthesize(
            scene=scenes[seed % 3], num_images=12 + 3 * seed, num_points=200 + 40 * seed, seed=seed
        ).problem
        settings = ({}, {"backend": "ceres"}, {"linear_solver_type": "sparse_schur"})
        yield f"model {seed}", _solve(problem, **settings[seed % 3])


def _solve(given: Any, **options: Any) -> Solve:
    return lambda: bundle.solve(given, **options)


def grid(seed: int, side: int) -> bundle.PoseGraph:
    """Poses on a grid, each joined with its four neighbours."""
    rng = np.random.default_rng(seed)
    index = np.arange(side * side).reshape(side, side)
    pairs = [
        np.stack([index[:, :-1].ravel(), index[:, 1:].ravel()], 1),
        np.stack([index[:-1].ravel(), index[1:].ravel()], 1),
    ]
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    truth = np.column_stack([x.ravel(), y.ravel(), np.zeros(side * side)])
    return graph_of(truth, np.vstack(pairs), rng, 0.02)


def hubs(seed: int, num_poses: int, num_hubs: int) -> bundle.PoseGraph:
    """A walk with hubs that a third of the poses observe."""
    rng = np.random.default_rng(seed)
    graph = chain_of_poses(seed, num_poses, 10)
    truth = np.vstack([graph.poses, 10 * rng.standard_normal((num_hubs, 3))])
    seen = np.flatnonzero(rng.random(num_poses) < 0.33)
    more = np.stack([seen, num_poses + rng.integers(0, num_hubs, len(seen))], 1)
    back = np.stack([np.zeros(num_hubs, int), num_poses + np.arange(num_hubs)], 1)
    return graph_of(truth, np.vstack([graph.edges, more, back]), rng, 0.02)


def factors(walk: bundle.PoseGraph) -> bundle.FactorGraph:
    """The same graph as a FactorGraph."""
    graph = bundle.FactorGraph()
    for k, pose in enumerate(walk.poses):
        graph.add_variable(k, pose, "se2", fixed=k == 0)
    for (a, b), z, weight in zip(
        walk.edges.tolist(), walk.measurements, walk.information, strict=True
    ):
        graph.add_factor(bundle.BetweenFactor(a, b, z, weight))
    return graph


def alarms(every: int = 1) -> list[str]:
    """Return the names of healthy inputs whose solve raises the alarm."""
    return [
        name
        for k, (name, solve) in enumerate(healthy())
        if k % every == 0 and "ordering" in solve().summary.warning_kinds
    ]


if __name__ == "__main__":
    sizes = [int(word) for word in sys.argv[1:3]] or [5000, 800]
    for order, summary in slow_and_fast(*sizes).items():
        seconds = summary.total_time_in_seconds
        print(f"{order:8} {seconds:9.3f} s {summary.factor_flops:10.3e} flops", summary.warnings)
    print(f"{len(list(healthy()))} healthy inputs, alarms: {alarms()}")
