"""Time of a step of a factor graph that Ceres solves: measured factors, counted matrices.

A step evaluates the residuals of all factors at the candidate, and residuals and Jacobians at the
accepted point. Factors are user code, so that their time is measured: a sample of each kind of
factor is solved as a graph of its own, with the times of both evaluations.

The rest is counts multiplied by rates of the machine. A factor has r residuals, and k free
variables with c free coordinates together.

- r c: nonzeros of J, which are scaled, copied and multiplied by vectors;
- k (k + 1) / 2 block products for J^T J, of r c^2 flops together;
- nnz(L) and flops of CHOLMOD's factor: column by column below 40 flops per nonzero, by dense panels
  above, as CHOLMOD decides (Chen, Davis, Hager, Rajamanickam: Algorithm 887, 2008);
- for a dense matrix of n columns and m rows of J: (m + n) n entries, m n^2 + n^3 / 3 flops.

Threads divide the evaluation of factors in C++; Ceres does the rest on one thread.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

import bundle._core as _core
from bundle.graphs.factors.factor_check import choose, kind_of
from bundle.graphs.factors.factor_graph import FactorGraph, free_pattern
from bundle.graphs.factors.factors import BetweenFactor, Factor
from bundle.interface.options import GraphOptions
from bundle.planning.inspection.machine_rates import Rates, Work, cached_rates, fitted
from bundle.planning.inspection.peak_memory import Terms
from bundle.planning.inspection.pose_graph_time import made_graph

FEATURES = (
    *("step", "entry", "block_product", "product_flop"),
    *("value", "flop", "panel_value", "panel_flop"),
    *("dense_step", "dense_entry", "dense_flop"),
)

FLOPS_OF_PANELS = 40.0  # flops per nonzero of L from which CHOLMOD factorises by panels

FIRST_SAMPLE, LARGEST_SAMPLE = 16, 5000
"""Factors of a kind that are timed."""

ENOUGH_SECONDS, MOST_SECONDS = 0.01, 1.0
"""Time of one evaluation of a sample, and time after which no further kind is measured."""

REPEATS = 3

CASES = (
    *(("chain", 12, d) for d in (3, 6)),
    *(("chain", 300, d) for d in (3, 6)),
    *(("grid", 100, d) for d in (3, 6)),
    *(("grid", 900, d) for d in (3, 6)),
    ("near", 2000, 3),
    ("near", 1500, 6),
    ("loops", 1500, 3),
    ("grid", 1600, 6),
    ("loops", 2500, 6),
    ("full", 90, 6),
)
"""Graphs of the calibration: kind, poses, tangent size."""

MOST_DENSE_COLUMNS = 600
"""Free coordinates up to which a graph of the calibration is solved by dense matrices, too."""


class FactorWork(NamedTuple):
    """Work of all factors with a free coordinate in one step."""

    evaluation: float  # seconds of residuals and Jacobians on one thread
    in_python: float  # the part of it that functions in Python take
    rows: float  # residuals
    entries: float  # nonzeros of J
    block_products: float  # products of two blocks of J
    product_flops: float  # flops of these products


class _Step(NamedTuple):
    """Seconds of the evaluations of a step and of the rest, and the number of residuals."""

    evaluation: float
    rest: float
    rows: int


class _Kind(NamedTuple):
    """Factors with the same code: seconds per step and number of residuals of a factor."""

    factors: Sequence[Factor]
    seconds: float
    rows: float


def factor_work(graph: FactorGraph) -> FactorWork:
    """Measure a sample of the factors of each kind, and count the products of all."""
    variables = graph.variables
    is_free = {key: sum(v.held) < len(v.coordinates) for key, v in variables.items()}
    kinds: dict[Any, list[Factor]] = {}
    for factor in graph.factors:
        if any(is_free[key] for key in factor.keys):
            kinds.setdefault(kind_of(factor, variables), []).append(factor)
    begun = perf_counter()
    found: list[_Kind] = []
    for same in sorted(kinds.values(), key=len, reverse=True):
        if not found or perf_counter() - begun < MOST_SECONDS:
            found.append(_measured_kind(graph, same))
        else:
            means = np.mean([(kind.seconds, kind.rows) for kind in found], axis=0)
            found.append(_Kind(same, *means.tolist()))
    return _sum(graph, found)


def factor_graph_rates(*, recalibrate: bool = False) -> Rates:
    """Return the rates of factor graphs that Ceres solves; measure them unless cached."""
    return cached_rates("factor-graph", FEATURES, 1, calibrate, recalibrate=recalibrate)


def step_terms(
    rates: Rates, work: FactorWork, counts: Mapping[str, Any], num_threads: int
) -> Terms:
    """Return the predicted time of a step, by its parts.

    ``counts``: ``_core.count_factor`` of the free variables, or {"columns": n} for dense matrices.
    """
    threads = 1 if work.in_python > 0 else num_threads  # a function takes all factors to one thread
    return {"factors": work.evaluation / threads} | rates.terms(step_work(work, counts))


def calibrate(num_threads: int) -> Rates:
    """Measure the rates by solves of small graphs on one thread, about a second in total."""
    solves = []
    for seed, (kind, count, size) in enumerate(CASES):
        graph = _made(kind, count, size, seed)
        pattern = free_pattern(graph.variables, graph.factors)
        columns = int(pattern.sizes.sum())
        counts = _core.count_factor(*pattern, _core.order_blocks(*pattern, "amd"))
        for dense in (False, True) if columns <= MOST_DENSE_COLUMNS else (False,):
            tried = [_step(graph, graph.factors, steps=3, dense=dense) for _ in range(REPEATS)]
            step = min(tried, key=lambda step: step.rest)
            each = step.rows / len(graph.factors)
            work = _sum(graph, [_Kind(graph.factors, step.evaluation / len(graph.factors), each)])
            solves.append((step_work(work, {"columns": columns} if dense else counts), step.rest))
    return fitted(FEATURES, num_threads, solves)


def _made(kind: str, num_poses: int, tangent_size: int, seed: int) -> FactorGraph:
    """Return a graph of the calibration of pose graphs as a factor graph."""
    poses = made_graph(kind, num_poses, tangent_size, seed=seed)
    graph = FactorGraph()
    manifold = "se2" if tangent_size == 3 else "se3"
    for place, pose in enumerate(poses.poses):
        graph.add_variable(place, pose, manifold, fixed=place == 0)
    for (a, b), measured in zip(poses.edges.tolist(), poses.measurements, strict=True):
        graph.add_factor(BetweenFactor(a, b, measured, information=100))
    return graph


def _measured_kind(graph: FactorGraph, same: Sequence[Factor]) -> _Kind:
    """Time a sample of factors, first a small one."""
    kinds, most = [0] * len(same), FIRST_SAMPLE
    for _ in range(2):
        sample = [same[place] for place in choose(kinds, most)]
        steps = [_step(graph, sample, steps=1) for _ in range(REPEATS)]
        best = min(steps, key=lambda step: step.evaluation)
        each = best.evaluation / len(sample)
        wanted = int(min(ENOUGH_SECONDS / max(each, 1e-9), LARGEST_SAMPLE))
        if wanted <= most or len(sample) == len(same):
            break
        most = wanted
    return _Kind(same, each, best.rows / len(sample))


def _step(
    graph: FactorGraph, factors: Sequence[Factor], *, steps: int, dense: bool = False
) -> _Step:
    """Solve with some of the factors on one thread, and time a step."""
    options = GraphOptions(
        linear_solver_type="dense_normal_cholesky" if dense else "sparse_normal_cholesky",
        num_threads=1,
        max_num_iterations=steps,
        function_tolerance=0.0,
        gradient_tolerance=0.0,
        parameter_tolerance=0.0,
    )
    as_core = options.asdict() | {"gauge": "none", "cheirality": "algebraic"}
    output = _core.solve_graph(*graph.core(factors), as_core, None, False)
    summary, iterations = output["summary"], output["iterations"]
    if summary["interrupted"]:  # a solve handles Ctrl-C itself
        raise KeyboardInterrupt
    jacobians = summary["jacobian_evaluation_time_in_seconds"]
    jacobians /= max(summary["num_jacobian_evaluations"], 1)
    residuals = summary["residual_evaluation_time_in_seconds"]
    count = summary["num_residual_evaluations"]
    # At a minimum no candidate is evaluated.
    evaluation = jacobians + (residuals / count if count > 0 else jacobians)
    # The first Jacobian belongs to the start, before the steps.
    others = summary["num_jacobian_evaluations"] - 1
    times = np.asarray(iterations["iteration_time_in_seconds"])[1:]
    rest = float(times.sum()) - max(residuals, 0.0) - max(others, 0) * jacobians
    return _Step(evaluation, rest / max(len(times), 1), summary["num_residuals"])


def _sum(graph: FactorGraph, kinds: Sequence[_Kind]) -> FactorWork:
    free = {key: len(v.coordinates) - sum(v.held) for key, v in graph.variables.items()}
    work = np.zeros(6)
    for factors, seconds, rows in kinds:
        sizes = [[free[key] for key in factor.keys if free[key]] for factor in factors]
        columns = np.array([sum(of_one) for of_one in sizes], float)
        blocks = np.array([len(of_one) for of_one in sizes], float)
        work += [
            len(factors) * seconds,
            len(factors) * seconds * (factors[0].kind == "function"),
            len(factors) * rows,
            rows * columns.sum(),
            (blocks * (blocks + 1) / 2).sum(),
            rows * (columns**2).sum(),
        ]
    return FactorWork(*work.tolist())


def step_work(work: FactorWork, counts: Mapping[str, Any]) -> Work:
    """Return the work of a step without the evaluation of the factors."""
    if "columns" in counts:
        n = float(counts["columns"])
        return {
            "normal equations": {"dense_entry": (work.rows + n) * n},
            "factorisation": {"dense_flop": work.rows * n**2 + n**3 / 3},
            "other": {"dense_step": 1.0},
        }
    by_panels = counts["cholmod_flops"] >= FLOPS_OF_PANELS * counts["entries"]
    value, flop = ("panel_value", "panel_flop") if by_panels else ("value", "flop")
    return {
        "normal equations": {
            "entry": work.entries,
            "block_product": work.block_products,
            "product_flop": work.product_flops,
        },
        "factorisation": {value: counts["entries"], flop: counts["cholmod_flops"]},
        "other": {"step": 1.0},
    }
