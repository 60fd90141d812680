"""Time of a step of a pose graph: counts multiplied by rates that small solves measure.

A Gauss-Newton step linearises the edges, factorises the normal equations panel by panel
(``cpp/core/linear/supernodal_cholesky.cpp``) and moves the poses. Its time is a sum of

- a constant, and times per edge and per pose, each in 2D and in 3D;
- a time per update of a slice of a panel by another panel, and per block row that an update has to
  locate;
- flops of the updates and flops of the panels' own columns, at two rates, and a time per value of
  the factor, which a step clears, fills, factorises and uses twice to solve;
- traffic beyond the second-level cache, and beyond a share of the third-level cache: bytes of
  edges and poses; the four passes over the values of the factor; and rows of panels that an update
  reads a long time after their last use (``cpp/core/prepare/panel_work.cpp``).

A narrow panel has many updates of few flops, so that its effective rate is low without a table of
rates by size. The times follow from solves of graphs whose counts differ, the largest beyond the
third-level cache.

Threads divide the edges equally. They divide the factorisation by its subtrees and by slices of the
panels above them: the busiest thread counts (``panel_work.cpp``). Solves of two graphs measure how
much time threads save.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from time import perf_counter, process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.graphs.pose_graphs.lie_groups import compose, inverse
from bundle.graphs.pose_graphs.solve_pose_graph import solve_pose_graph
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.inspection.machine_rates import Rates, Work, cached_rates, fitted
from bundle.planning.inspection.peak_memory import Terms
from bundle.planning.inspection.problem_pattern import BlockPattern, pattern_of_edges

NEAR_CACHE, FAR_CACHE = 1e6, 24e6
"""Bytes from which data leave the second-level cache, and the share of a third-level cache of 32 MB
that a solve may expect."""

EDGE_BYTES, POSE_BYTES = {3: 100.0, 6: 290.0}, {3: 100.0, 6: 250.0}
"""Bytes of an edge and of a pose, by tangent size."""

EDGES_OF_A_THREAD = 70_000
"""Edges, weighted by the square of their coordinates, per thread (``pose_graph_problem.cpp``)."""

PASSES = 4  # passes of a step over the values of the factor

FEATURES = (
    *("step", "edge_3", "edge_6", "pose_3", "pose_6", "update", "row_block"),
    *("update_flop", "factor_flop", "value", "near_byte", "far_byte", "near_value", "far_value"),
)

PARALLEL = {
    "edges": (1.0, False),
    "poses": (0.2, False),
    "updates of panels": (1.0, True),
    "flops": (1.0, True),
    "values of the factor": (0.4, True),
}
"""Share of a term that threads divide, and True if they divide it as they divide the factorisation,
not equally. All threads move poses, one damps them; one thread clears the factor and solves."""

ENOUGH_SECONDS, LONG_ENOUGH, LEAST_REPEATS = 0.04, 0.3, 3
"""Seconds of solves after which no other follows, in general and before the least repeats."""
LONG, LARGE = 1e-3, 3000
"""Seconds of a step that counts as long, and poses of a graph whose steps are."""

STEPS = 3

CASES = (
    *(("chain", 150, d, "natural") for d in (3, 6)),
    *(("chain", 2500, d, "natural") for d in (3, 6)),
    ("chain", 20000, 3, "natural"),
    *(("grid", 100, d, "natural") for d in (3, 6)),
    *(("grid", 400, d, order) for d in (3, 6) for order in ("natural", "amd")),
    *(("near", 400, d, order) for d in (3, 6) for order in ("natural", "metis")),
    *(("near", 2500, d, order) for d in (3, 6) for order in ("natural", "amd")),
    ("grid", 1600, 3, "metis"),
    *(("grid", 900, 6, order) for order in ("natural", "amd")),
    ("grid", 1600, 6, "metis"),
    *(("loops", 1500, d, "natural") for d in (3, 6)),
    ("hubs", 8000, 3, "amd"),
    ("grid", 2000, 6, "natural"),
    ("near", 10000, 6, "amd"),
    ("grid", 6400, 6, "metis"),
    ("near", 40000, 6, "amd"),
    ("chain", 60000, 6, "natural"),
    *(("band", 1500, d, "natural") for d in (3, 6)),
    *(("full", poses, d, "natural") for poses, d in ((40, 3), (130, 3), (60, 6))),
    ("loops", 4000, 3, "natural"),
    ("loops", 2500, 6, "metis"),
)
"""Graphs and orders of the calibration: kind, poses, tangent size, order."""


def free_pattern(graph: PoseGraph) -> BlockPattern:
    """Return the pattern of the normal equations over the free poses."""
    held, _, _ = _core.hold_poses(graph)
    pairs = np.unique(np.sort(graph.edges.astype(np.int64), axis=1), axis=0).reshape(-1, 2)
    number = np.cumsum(~held) - 1
    sizes = np.full(int((~held).sum()), graph.tangent_size, np.int32)
    return pattern_of_edges(sizes, number[pairs[~held[pairs].any(axis=1)]])


def pose_graph_rates(num_threads: int, *, recalibrate: bool = False) -> Rates:
    """Return the rates of pose graphs on ``num_threads`` threads; measure them unless cached."""
    return cached_rates("pose-graph", FEATURES, num_threads, calibrate, recalibrate=recalibrate)


def step_terms(rates: Rates, graph: PoseGraph, work: Mapping[str, float]) -> Terms:
    """Return the predicted time of a step, by its parts."""
    size = graph.num_edges * graph.tangent_size**2
    threads = min(rates.num_threads, max(1, size // EDGES_OF_A_THREAD))
    terms = rates.terms(step_work(graph, work))
    if threads == 1:
        return terms
    for name, (parallel, of_factor) in PARALLEL.items():
        saved = parallel * (1 - (work["busiest_share"] if of_factor else 1 / threads))
        terms[name] *= 1 - rates.efficiency * saved
    return terms


def calibrate(num_threads: int) -> Rates:
    """Measure the rates by solves of small graphs, about two seconds in total."""
    solves = []
    for k, (kind, count, size, ordering) in enumerate(CASES):
        graph = made_graph(kind, count, size, seed=k)
        solves.append((step_work(graph, _work(graph, ordering)), step_time(graph, ordering, 1)))
    rates = fitted(FEATURES, num_threads, solves)
    return rates if num_threads == 1 else _with_efficiency(rates)


def _with_efficiency(rates: Rates) -> Rates:
    """Measure the time that the machine's threads save, relative to ideal threads."""
    found = []
    for kind, poses, ordering in (("near", 5000, "amd"), ("loops", 3000, "metis")):
        graph = made_graph(kind, poses * rates.num_threads, 6, seed=99)
        work = _work(graph, ordering, rates.num_threads)
        one, ideal = (
            sum(step_terms(replace(rates, num_threads=threads), graph, work).values())
            for threads in (1, rates.num_threads)
        )
        # Other load can only lengthen a step.
        times = [[step_time(graph, ordering, t) for t in (1, rates.num_threads)] for _ in range(3)]
        first, all_threads = np.min(times, axis=0)
        found.append((1 - all_threads / first) / (1 - ideal / one))
    return replace(rates, efficiency=float(np.clip(np.nan_to_num(np.mean(found)), 0.0, 1.0)))


def made_graph(kind: str, num_poses: int, tangent_size: int, *, seed: int) -> PoseGraph:
    """Return a seeded graph near its minimum: a chain, with more edges for other kinds.

    "grid": rows of equal length, poses of neighbouring rows joined; "near": closures within a
    fiftieth of the chain; "loops": closures anywhere; "hubs": closures to three poses; "band":
    closures over 2, 3 and 5 poses; "full": all pairs.
    """
    rng = np.random.default_rng(seed)
    first = np.arange(num_poses - 1)
    edges = [np.stack([first, first + 1], axis=1)]
    if kind == "grid":
        width = int(np.sqrt(num_poses))
        edges.append(np.stack([np.arange(num_poses - width), np.arange(width, num_poses)], axis=1))
    elif kind == "near":
        a = rng.integers(0, num_poses - 2, max(1, num_poses // 4))
        step = rng.integers(2, max(3, num_poses // 50), len(a))
        edges.append(np.stack([a, np.minimum(a + step, num_poses - 1)], axis=1))
    elif kind == "loops":
        edges.append(rng.integers(0, num_poses, (max(1, num_poses // 20), 2)))
    elif kind == "hubs":
        a = rng.integers(0, num_poses, num_poses // 5)
        edges.append(np.stack([a, rng.integers(0, num_poses, 3)[rng.integers(0, 3, len(a))]], 1))
    elif kind == "band":
        edges += [
            np.stack([np.arange(num_poses - d), np.arange(d, num_poses)], 1) for d in (2, 3, 5)
        ]
    elif kind == "full":
        edges.append(np.stack(np.triu_indices(num_poses, 1), axis=1))
    pairs = np.sort(np.concatenate(edges), axis=1)
    pairs = np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0)
    t = 0.05 * np.arange(num_poses)
    xy = np.stack([10 * np.cos(t / 7), 10 * np.sin(t / 5)], axis=1)
    noise = 0.01
    if tangent_size == 3:
        poses = np.concatenate([xy, np.mod(0.1 * t, 6)[:, None] - 3], axis=1)
        measured = compose(inverse(poses[pairs[:, 0]]), poses[pairs[:, 1]])
        measured += noise * rng.normal(size=measured.shape)
        start = poses + 2 * noise * rng.normal(size=poses.shape)
    else:
        turns = 0.2 * rng.normal(size=(num_poses, 4)) + [0, 0, 0, 1]
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        poses = np.concatenate([turns, xy, 0.1 * t[:, None]], axis=1)
        measured = compose(inverse(poses[pairs[:, 0]]), poses[pairs[:, 1]])
        measured += 0.5 * noise * rng.normal(size=measured.shape)
        start = poses + noise * rng.normal(size=poses.shape)
    return PoseGraph(
        poses=start,
        edges=pairs.astype(np.int32),
        measurements=measured,
        information=np.tile(100 * np.eye(tangent_size), (len(pairs), 1, 1)),
    )


def panel_work(
    pattern: BlockPattern, order: NDArray[np.int32], num_threads: int = 1
) -> dict[str, float]:
    """Return the counts of ``cpp/core/prepare/panel_work.h``, with the caches assumed here."""
    return _core.panel_work(*pattern, order, NEAR_CACHE, FAR_CACHE, num_threads)


def _work(graph: PoseGraph, ordering: str, num_threads: int = 1) -> dict[str, float]:
    pattern = free_pattern(graph)
    return panel_work(pattern, _core.order_blocks(*pattern, ordering), num_threads)


def step_work(graph: PoseGraph, work: Mapping[str, float]) -> Work:
    """Return the work of a step; ``work``: that of its factor, from :func:`panel_work`."""
    d, edges, poses = graph.tangent_size, graph.num_edges, graph.num_poses
    of_graph = EDGE_BYTES[d] * edges + POSE_BYTES[d] * poses
    total = of_graph + 8 * work["stored"]

    def beyond(cache: float) -> float:
        """Return the share of the data that a cache does not hold, from 0 to 1."""
        return float(np.clip((total - cache) / cache, 0, 1))

    near, far = beyond(NEAR_CACHE), beyond(FAR_CACHE)
    return {
        "edges": {f"edge_{d}": edges, "near_byte": of_graph * near, "far_byte": of_graph * far},
        "poses": {f"pose_{d}": poses},
        "updates of panels": {"update": work["updates"], "row_block": work["row_blocks"]},
        "flops": {"update_flop": work["update_flops"], "factor_flop": work["factor_flops"]},
        "values of the factor": {
            "value": work["stored"],
            "near_value": PASSES * work["stored"] * near + work["near_misses"],
            "far_value": PASSES * work["stored"] * far + work["far_misses"],
        },
        "other": {"step": 1.0},
    }


def step_time(graph: PoseGraph, ordering: str, num_threads: int) -> float:
    """Return the shortest step of several solves; NaN if none is whole.

    An accepted step includes the linearisation at its end. After a rejected step, the next step
    linearises again, with more damping. A step is whole if it linearises once: if it is accepted
    after an accepted one, or rejected after a rejected one.

    Other load only adds time. A long step on one thread is measured in processor time, which other
    load changes little; for a short step, reading this time takes too long.
    """
    found: list[float] = []
    begun = perf_counter()
    repeats = 0
    while perf_counter() - begun < (ENOUGH_SECONDS if repeats >= LEAST_REPEATS else LONG_ENOUGH):
        repeats += 1
        clock: list[float] = []
        is_long = (graph.num_poses > LARGE or min(found, default=0.0) > LONG) and num_threads == 1

        def read(_: Any, clock: list[float] = clock) -> None:
            clock.append(process_time())

        result: Any = solve_pose_graph(
            graph,
            ordering=ordering,
            init="file",
            num_threads=num_threads,
            max_num_iterations=STEPS,
            function_tolerance=0.0,
            gradient_tolerance=0.0,
            parameter_tolerance=0.0,
            progress=read if is_long else None,
        )
        taken = np.asarray(result.iterations["step_is_successful"], bool)
        times = np.asarray(result.iterations["iteration_time_in_seconds"])[1:]
        if is_long and len(clock) == len(times) + 1:
            times = np.diff(clock)
        found += times[taken[1:] == taken[:-1]].tolist()
    return min(found, default=float("nan"))
