"""Comparison of solver methods on a pose graph or a factor graph, with one recommendation.

A factor graph of relative poses or of reprojections is compared as the pose graph or the problem
that it represents (``compare_methods.py``). Any other is solved by Ceres with each linear solver
and trust region, and by a QR factorisation of its Jacobian.

``graph_distance`` is in sigmas of the covariance. Let X_a and X_b be two solutions with the same
constant poses, and Lambda = J^T W J the information of all edges at X_b, with the weights W of the
loss. With the covariance C = sigma0^2 Lambda^-1 the distance of the tangent coordinates d,
X_a = X_b Exp(d), is

    d^T C^-1 d = sum w ||log((X_b,i^-1 X_b,j)^-1 (X_a,i^-1 X_a,j))||^2_Omega / sigma0^2

to first order: J d is the change of the relative poses, in sigmas of the edges. It is the chi2 of a
graph whose edges measure the relative poses of X_b, and bounds every pose and every combination of
poses by that many sigmas, as for reconstructions (``minima``).
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import bundle._core as _core
from bundle.base.arrays import check_function, check_type
from bundle.base.display import Display, Displayed
from bundle.base.paths import as_path, is_path
from bundle.base.records import dataclass
from bundle.base.words import number, plural, seconds
from bundle.errors import InputError
from bundle.graphs.factors.factor_graph import FactorGraph, GraphResult
from bundle.graphs.pose_graphs.edge_weights import (
    check_free_pose,
    check_information_exists,
    checked_information,
)
from bundle.graphs.pose_graphs.lie_groups import compose, inverse
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.graphs.pose_graphs.solve_pose_graph import solve_pose_graph
from bundle.interface.environment import Environment
from bundle.interface.option_fields import choice
from bundle.interface.option_fields import number as checked_number
from bundle.interface.options import GraphOptions, SolveOptions
from bundle.interface.planning_options import BACKENDS, REPEAT, SECONDS_NOT_REPEATED, TIMEOUT
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.tabular import Tabular
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.comparison.measured_run import (
    FactorGraphMethod,
    GraphMethod,
    as_tuple,
    thread_counts,
)
from bundle.planning.comparison.recommendation import command_line
from bundle.planning.inspection.elimination_costs import inspect_factor_graph, inspect_pose_graph

ORDERINGS = ("amd", "metis", "natural")
TRUST_REGIONS = ("gauss_newton", "levenberg_marquardt", "dogleg", "subspace_dogleg")
VARIED = ("backend", "ordering", "trust_region_strategy_type", "num_threads")
VARIED_OF_FACTORS = ("linear_solver_type", "trust_region_strategy_type", "num_threads")


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GraphComparison(Displayed, Tabular):
    """Solves of one pose graph or factor graph by several methods.

    Attributes:
        graph: common start of all methods, with its poses or values.
        options: options of every solve, except those that the methods vary.
        runs: one per method.
        recommended: fastest of the methods that reach the best cost within 1e-6. Methods within
            15 % of its time count as equal, and the first one is recommended. None if no method has
            a usable solution.
        reason: reason in one sentence.
        command: command line of the method; for a factor graph the expression in Python.
        warnings: warnings of the recommended solve.
        repeat: solves of each method, of which the median time counts.
        timeout: seconds after which a solve was stopped.
        environment: machine, load, versions and date.
    """

    graph: PoseGraph | FactorGraph
    options: PoseGraphOptions | SolveOptions
    runs: tuple[GraphRun, ...]
    recommended: GraphMethod | FactorGraphMethod | None
    reason: str
    command: str
    warnings: tuple[str, ...]
    repeat: int
    timeout: float
    environment: Environment

    def gap(self, run: GraphRun) -> float:
        """Return the relative distance of a run's final cost to the best one."""
        best = best_cost(self.runs)
        return (run.final_cost - best) / best if best > 0 else run.final_cost - best

    def distance_in_sigmas(self, run: GraphRun) -> float:
        """Return the distance to the solution of the lowest cost, in sigmas of its covariance.

        NaN for a failed run, and for a factor graph.
        """
        usable = [one for one in self.runs if not one.failure]
        if run.failure or not isinstance(run.result, PoseGraphResult):
            return math.nan
        best = min(usable, key=lambda one: one.final_cost)
        return graph_distance(run.result, best.result)

    def _display(self) -> Display:
        facts = [
            (
                run.method.name,
                run.failure or f"{seconds(run.time_in_seconds)} s, {run.final_cost:.6g}",
            )
            for run in self.runs
        ]
        title = f"GraphComparison: {plural(len(self.runs), 'method')}"
        return Display(title=title, facts=(*facts, ("advice", self.reason)))


Solve = Callable[[Callable[[Any], None]], tuple[Any, float]]
"""Function of a progress callback that returns the result of a solve and its chi2."""


def compare_graph(
    source: Any,
    options: PoseGraphOptions | None = None,
    *,
    backends: Iterable[str] = BACKENDS,
    threads: Iterable[int] = (0,),
    repeat: int = REPEAT,
    timeout: float = TIMEOUT,
    progress: Callable[[str], None] | None = None,
    orders_only: bool = False,
    **changes: Any,
) -> GraphComparison:
    """Solve a pose graph from one start by every method; see :func:`bundle.compare`.

    With ``orders_only`` the methods differ in the elimination order alone.
    """
    if isinstance(source, PoseGraphResult):
        source = source.initial_problem
    elif is_path(source):
        source = load_g2o(as_path(source))
    check_type("graph", source, PoseGraph)
    check_free_pose(source)
    check_information_exists(source)
    if options is not None and not isinstance(options, PoseGraphOptions):
        raise InputError(f"options: expected PoseGraphOptions, found {type(options).__name__}")
    options = PoseGraphOptions.of(options, changes, "compare")
    check_not_varied(options, PoseGraphOptions(), VARIED)
    if options.loss == "auto":
        raise InputError("loss: expected a named loss to compare methods with, found auto")
    limits = _limits(repeat, timeout, progress)
    methods = _methods(
        ("fused",) if orders_only else _listed("backends", backends),
        _listed("threads", threads),
        options.loss,
        TRUST_REGIONS[:1] if orders_only else TRUST_REGIONS,
    )
    # The start is computed once, because all methods must share it.
    started = solve_pose_graph(source, options.replace(max_num_iterations=0)).problem
    base = options.replace(init="file")
    inspected = {
        count: {c.ordering: c for c in inspect_pose_graph(started, count).costs}
        for count in {method.num_threads for method in methods if method.backend == "fused"}
    }

    def time_of_step(method: GraphMethod) -> float:
        if method.backend != "fused":
            return math.nan
        return inspected[method.num_threads][method.ordering].time_per_step_in_seconds

    def solver(method: GraphMethod) -> Solve:
        def solve(progress: Callable[[Any], None]) -> tuple[PoseGraphResult, float]:
            result = solve_pose_graph(started, method.options(base), progress=progress)
            return result, result.summary.chi2_final

        return solve

    return _compared(
        started,
        options,
        limits,
        methods,
        solver,
        time_of_step,
        lambda method: _command(started, options, method),
    )


Limits = tuple[int, float, Callable[[str], None] | None]
"""Solves of each method, seconds after which one is stopped, and a function of a method's name."""


def _limits(repeat: int, timeout: float, progress: Callable[[str], None] | None) -> Limits:
    repeat = checked_number("repeat", repeat, whole=True, minimum=1)
    timeout = checked_number("timeout", timeout, above=0)
    check_function("progress", progress)
    return repeat, timeout, progress


def _compared(
    graph: PoseGraph | FactorGraph,
    options: PoseGraphOptions | SolveOptions,
    limits: Limits,
    methods: Iterable[Any],
    solver: Callable[[Any], Solve],
    predicted: Callable[[Any], float],
    command: Callable[[Any], str],
) -> GraphComparison:
    """Solve by each method, and recommend one.

    ``solver``, ``predicted`` and ``command``: solve, predicted seconds of a step (NaN if unknown)
    and command line of a method.
    """
    environment = Environment.now()
    repeat, timeout, progress = limits
    runs = []
    for method in methods:
        if progress is not None:
            progress(method.name)
        runs.append(measure(method, solver(method), repeat, timeout, predicted(method)))
    best, reason = recommend_run(runs)
    return GraphComparison(
        graph=graph,
        options=options,
        runs=tuple(runs),
        recommended=best.method if best else None,
        reason=reason,
        command=command(best.method) if best else "",
        warnings=best.warnings if best else (),
        repeat=repeat,
        timeout=timeout,
        environment=environment.finished(),
    )


def check_not_varied(options: Any, defaults: Any, varied: Iterable[str]) -> None:
    """Refuse options that the methods of a comparison vary."""
    for name in varied:
        if getattr(options, name) != getattr(defaults, name):
            raise InputError(f"{name}: expected its default, because it is compared")


def _methods(
    backends: tuple[Any, ...], threads: tuple[Any, ...], loss: str, regions: tuple[str, ...]
) -> list[GraphMethod]:
    counts = thread_counts("threads", threads)
    found = []
    for backend in [choice("backends", name, BACKENDS) for name in backends]:
        if backend == "ceres" and loss in ("geman_mcclure", "switchable", "dcs"):
            continue  # Ceres does not have these losses
        pairs = [(region, "amd") for region in regions]
        pairs += [(TRUST_REGIONS[0], ordering) for ordering in ORDERINGS[1:]]
        for count in counts:
            for region, ordering in pairs:
                method = GraphMethod(
                    backend=backend,
                    trust_region_strategy_type=region,
                    ordering=ordering if backend == "fused" else "",
                    num_threads=count,
                )
                if method not in found:
                    found.append(method)
    if not found:
        raise InputError("backends: expected one that supports this loss, found 0")
    return found


def _listed(name: str, values: Any) -> tuple[Any, ...]:
    listed = as_tuple(name, values)
    if not listed:
        raise InputError(f"{name}: expected at least one value to compare, found 0")
    return listed


def _command(graph: PoseGraph, options: PoseGraphOptions, method: GraphMethod) -> str:
    """Return the command, without options that equal the automatic choice."""
    chosen = method.options(options)
    held, _, _ = _core.hold_poses(graph)
    if chosen.num_threads == _core.hardware_threads():
        chosen = chosen.replace(num_threads=0)
    if chosen.backend == "fused":
        chosen = chosen.replace(backend="auto")
    if method.ordering == _core.auto_ordering(graph, held):
        chosen = chosen.replace(ordering="auto")
    return command_line(chosen, graph.path or "INPUT")


SOLVERS = ("sparse_normal_cholesky", "dense_normal_cholesky", "square_root")
ORDERS = {"sparse_normal_cholesky": "amd", "dense_normal_cholesky": "dense"}
_REGIONS = ("levenberg_marquardt", "gauss_newton", "dogleg", "subspace_dogleg")

PREDICTED = ("levenberg_marquardt", "gauss_newton")
"""Trust regions whose step is one linear solve, which :func:`bundle.inspect` predicts."""

MOST_DENSE_COLUMNS = 2000
"""Free coordinates up to which dense matrices are compared: 32 MB and a second per step."""


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
    check_not_varied(chosen, GraphOptions(), VARIED_OF_FACTORS)
    limits = _limits(repeat, timeout, progress)
    counts = thread_counts("threads", as_tuple("threads", threads))
    inspected = {count: inspect_factor_graph(graph, count).costs for count in counts}

    def time_of_step(method: FactorGraphMethod) -> float:
        if method.trust_region_strategy_type not in PREDICTED:
            return math.nan
        order = ORDERS.get(method.linear_solver_type)
        costs = inspected[method.num_threads]
        return next((c.time_per_step_in_seconds for c in costs if c.ordering == order), math.nan)

    return _compared(
        graph,
        chosen,
        limits,
        _factor_methods(graph, counts),
        lambda method: _factor_solver(graph, chosen, method),
        time_of_step,
        _expression,
    )


def _factor_methods(graph: FactorGraph, counts: tuple[int, ...]) -> list[FactorGraphMethod]:
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
        for region in (_REGIONS if solver == solvers[0] else _REGIONS[:1])
        if not (has_bounds and region.endswith("dogleg"))
    ]


def _factor_solver(graph: FactorGraph, options: SolveOptions, method: FactorGraphMethod) -> Solve:
    arguments = method.arguments()
    by_root = arguments.pop("square_root", False)

    def solve(progress: Callable[[Any], None]) -> tuple[GraphResult, float]:
        used = options.replace(**arguments)
        result = graph.solve(used, square_root=by_root, progress=progress)
        _, squares, _ = _core.factor_costs(*graph.with_values(result.values).core())
        return result, float(squares.sum())

    return solve


def _expression(method: FactorGraphMethod) -> str:
    """Return the expression that solves by the method, without arguments at their default."""
    given = method.arguments()
    if given["num_threads"] in (0, _core.hardware_threads()):
        del given["num_threads"]
    if given["trust_region_strategy_type"] == GraphOptions().trust_region_strategy_type:
        del given["trust_region_strategy_type"]
    words = ", ".join(f"{name}={value!r}" for name, value in given.items())
    return f"graph.solve({words})"


NEAR_ENOUGH = 1.15  # factor of the shortest time within which methods count as equally fast

COST_TOLERANCE = 1e-6
"""Relative distance to the best final cost within which solutions count as equally good."""

DIAGNOSE = "run bundle diagnose to find the cause"


@dataclass(frozen=True, kw_only=True)
class GraphRun:
    """Measurement of one method.

    Attributes:
        method: the method, an object with a ``name``.
        times_in_seconds: time of each solve, without reading and without the start.
        final_cost: 1/2 sum rho; NaN after a failure.
        chi2_final: sum of squares without 1/2 and without loss; NaN after a failure.
        num_steps: number of attempted steps.
        termination_type: as in a summary, or "TIMEOUT".
        failure: reason for a missing solution, as a sentence; "" with a solution.
        warnings: warnings of the solve.
        result: the last solve; None after a failure.
        predicted_time_per_step_in_seconds: prediction of :func:`bundle.inspect`; NaN without one.
    """

    method: Any
    times_in_seconds: tuple[float, ...] = ()
    final_cost: float = math.nan
    chi2_final: float = math.nan
    num_steps: int = 0
    termination_type: str
    failure: str = ""
    warnings: tuple[str, ...] = ()
    result: Any = None
    predicted_time_per_step_in_seconds: float = math.nan

    @property
    def time_per_step_in_seconds(self) -> float:
        """Median time of the steps of the last solve; NaN without a step."""
        if self.result is None or self.num_steps < 1:
            return math.nan
        times = self.result.iterations["iteration_time_in_seconds"][1:].tolist()
        return float(statistics.median(times))

    @property
    def time_in_seconds(self) -> float:
        """Median time; NaN after a failure."""
        return statistics.median(self.times_in_seconds) if self.times_in_seconds else math.nan


def measure(
    method: Any, solve: Solve, repeat: int, timeout: float, predicted: float = math.nan
) -> GraphRun:
    """Solve several times by one method; times in seconds, ``predicted`` that of a step."""

    def failed(termination: str, failure: str) -> GraphRun:
        return GraphRun(method=method, termination_type=termination, failure=failure)

    times: list[float] = []
    for _ in range(repeat):
        begun = time.perf_counter()

        def watch(_: Any, begun: float = begun) -> None:
            if time.perf_counter() - begun > timeout:
                raise _TimeoutError

        try:
            result, chi2 = solve(watch)
        except _TimeoutError:
            return failed("TIMEOUT", f"stopped after {number(timeout)} s")
        except InputError:
            raise
        except (RuntimeError, MemoryError) as error:
            return failed("FAILURE", str(error).partition("\n")[0] or "no memory")
        summary = result.summary
        if summary.interrupted:
            raise KeyboardInterrupt
        if not summary.is_solution_usable:
            return failed(summary.termination_type, summary.message)
        times.append(result.solve_time_in_seconds)
        if times[-1] > SECONDS_NOT_REPEATED:
            break
    return GraphRun(
        method=method,
        times_in_seconds=tuple(times),
        final_cost=summary.final_cost,
        chi2_final=chi2,
        num_steps=len(result.iterations["cost"]) - 1,
        termination_type=summary.termination_type,
        warnings=tuple(summary.warnings),
        result=result,
        predicted_time_per_step_in_seconds=predicted,
    )


class _TimeoutError(Exception):
    """Time limit of a solve exceeded."""


def best_cost(runs: Iterable[GraphRun]) -> float:
    """Return the lowest final cost; NaN without a usable solution."""
    return min((run.final_cost for run in runs if not run.failure), default=math.nan)


def recommend_run(runs: Sequence[GraphRun]) -> tuple[GraphRun | None, str]:
    """Return the recommended run and the reason; None without a usable solution."""
    usable = [run for run in runs if not run.failure]
    if not usable:
        return None, f"No method has a usable solution: {DIAGNOSE}."
    best = best_cost(usable)
    limit = best + COST_TOLERANCE * abs(best)
    good = sorted(
        (run for run in usable if run.final_cost <= limit), key=lambda run: run.time_in_seconds
    )
    near = [run for run in good if run.time_in_seconds <= NEAR_ENOUGH * good[0].time_in_seconds]
    first = min(near, key=runs.index)  # earlier methods are closer to the defaults
    reason = (
        f"{first.method.name} took {seconds(first.time_in_seconds)} s to the lowest cost "
        f"{best:.6g}, at most {round(100 * (NEAR_ENOUGH - 1))} % more than the fastest of the "
        f"{plural(len(good), 'method')} that reached it"
    )
    others = [run for run in good if _family(run) != _family(first)]
    if others:
        ratio = others[0].time_in_seconds / max(first.time_in_seconds, 1e-9)
        reason += f"; {others[0].method.name} took {number(ratio)} times as long"
    worse = len(usable) - len(good)
    if worse:
        reason += (
            f"; {plural(worse, 'method')} ended at a higher cost, in another minimum or not "
            "converged"
        )
    return first, reason + "."


def _family(run: GraphRun) -> str:
    """Return the first word of a method's name: the backend, or the solver."""
    return str(run.method.name).partition(" ")[0]


LEAST_SIGMA0 = 1e-3
"""Least sigma0. Data without noise would make rounding errors many sigmas."""


def graph_distance(one: PoseGraphResult, best: PoseGraphResult) -> float:
    """Return the distance of two solutions in sigmas; ``best`` has the lower cost."""
    graph = checked_information(best.problem, best.options.information)
    first, second = graph.edges.T
    poses = graph.poses
    between = compose(inverse(poses[first]), poses[second])
    there = graph.replace(measurements=between, poses=one.problem.poses)
    apart = float(best.weights @ _core.edge_chi2(there, "log"))
    freedom = graph.tangent_size * (graph.num_edges - graph.num_poses + graph.num_components)
    variance = float(best.weights @ best.chi2_after) / max(freedom, 1)
    return math.sqrt(apart) / max(math.sqrt(variance), LEAST_SIGMA0)
