"""Comparison of methods on a factor graph, with one recommendation.

A graph of relative poses or of reprojections is compared as the pose graph or the problem that it
states (``compare_methods.py``). Any other is solved by Ceres with each linear solver and trust
region, and by a QR factorisation of its Jacobian.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import bundle._core as _core
from bundle.graphs.factors.factor_graph import FactorGraph, GraphResult
from bundle.interface.options import GraphOptions, SolveOptions
from bundle.interface.planning_options import REPEAT, TIMEOUT
from bundle.planning.comparison.graph_comparison import (
    GraphComparison,
    Runner,
    Solve,
    check_not_varied,
)
from bundle.planning.comparison.method import FactorGraphMethod, as_tuple, thread_counts
from bundle.planning.inspection.elimination_costs import inspect_factor_graph

SOLVERS = ("sparse_normal_cholesky", "dense_normal_cholesky", "square_root")
TRUST_REGIONS = ("levenberg_marquardt", "gauss_newton", "dogleg", "subspace_dogleg")

PREDICTED = ("levenberg_marquardt", "gauss_newton")
"""Trust regions whose step is one linear solve, which :func:`bundle.inspect` predicts."""

MOST_DENSE_COLUMNS = 2000
"""Free coordinates up to which dense matrices are compared: 32 MB and a second per step."""

VARIED = ("linear_solver_type", "trust_region_strategy_type", "num_threads")


def compare_factor_graph(
    graph: FactorGraph,
    options: SolveOptions | None = None,
    *,
    threads: Iterable[int] = (0,),
    repeat: int = REPEAT,
    timeout: float = TIMEOUT,
    progress: Callable[[str], None] | None = None,
    changes: dict[str, Any],
) -> GraphComparison:
    """Solve a factor graph from its values by every method; see :func:`bundle.compare`."""
    graph.check_free()
    chosen = GraphOptions.of(options, changes, "compare")
    check_not_varied(chosen, GraphOptions(), VARIED)
    runner = Runner(repeat, timeout, progress)
    counts = thread_counts("threads", as_tuple("threads", threads))
    predicted = {count: _predicted(graph, count) for count in counts}

    def time(method: FactorGraphMethod) -> float:
        if method.trust_region_strategy_type not in PREDICTED:
            return math.nan
        return predicted[method.num_threads].get(method.linear_solver_type, math.nan)

    return runner.compare(
        graph,
        chosen,
        _methods(graph, counts),
        lambda method: _solver(graph, chosen, method),
        time,
        _command,
    )


def _methods(graph: FactorGraph, counts: tuple[int, ...]) -> list[FactorGraphMethod]:
    variables = graph.variables.values()
    columns = sum(len(v.coordinates) - sum(v.held) for v in variables)
    has_bounds = any(len(v.lower) for v in variables)
    solvers = [
        name
        for name in SOLVERS
        if not (name == "dense_normal_cholesky" and columns > MOST_DENSE_COLUMNS)
        and not (name == "square_root" and has_bounds)
    ]
    return [
        FactorGraphMethod(
            linear_solver_type=solver, trust_region_strategy_type=region, num_threads=count
        )
        for count in counts
        for solver in solvers
        for region in (TRUST_REGIONS if solver == solvers[0] else TRUST_REGIONS[:1])
        if not (has_bounds and region.endswith("dogleg"))
    ]


def _predicted(graph: FactorGraph, num_threads: int) -> dict[str, float]:
    """Return the predicted seconds of a step by linear solver; NaN if a factor failed."""
    costs = {
        cost.ordering: cost.time_per_step_in_seconds
        for cost in inspect_factor_graph(graph, num_threads).costs
    }
    return {"sparse_normal_cholesky": costs["amd"], "dense_normal_cholesky": costs["dense"]}


def _solver(graph: FactorGraph, options: SolveOptions, method: FactorGraphMethod) -> Solve:
    arguments = method.arguments()
    by_root = arguments.pop("square_root", False)

    def solve(progress: Callable[[Any], None]) -> tuple[GraphResult, float]:
        used = options.replace(**arguments)
        result = graph.solve(used, square_root=by_root, progress=progress)
        _, squares, _ = _core.factor_costs(*graph.with_values(result.values).core())
        return result, float(squares.sum())

    return solve


def _command(method: FactorGraphMethod) -> str:
    """Return the expression that solves by the method, without arguments at their default."""
    given = method.arguments()
    if given["num_threads"] in (0, _core.hardware_threads()):
        del given["num_threads"]
    if given["trust_region_strategy_type"] == GraphOptions().trust_region_strategy_type:
        del given["trust_region_strategy_type"]
    words = ", ".join(f"{name}={value!r}" for name, value in given.items())
    return f"graph.solve({words})"
