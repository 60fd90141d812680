"""Comparison of solver methods on a pose graph, with one recommendation.

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
from bundle.graphs.factors.factor_graph import FactorGraph
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
from bundle.interface.options import SolveOptions
from bundle.interface.planning_options import BACKENDS, REPEAT, SECONDS_NOT_REPEATED, TIMEOUT
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.tabular import Tabular
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.comparison.method import FactorGraphMethod, as_tuple, thread_counts
from bundle.planning.comparison.recommendation import command_line
from bundle.planning.inspection.elimination_costs import inspect_pose_graph

ORDERINGS = ("amd", "metis", "natural")
TRUST_REGIONS = ("gauss_newton", "levenberg_marquardt", "dogleg", "subspace_dogleg")
VARIED = ("backend", "ordering", "trust_region_strategy_type", "num_threads")


@dataclass(frozen=True, kw_only=True)
class GraphMethod:
    """Options of a compared method, named as in :class:`bundle.PoseGraphOptions`.

    ``ordering`` is "" for Ceres, which chooses its own.
    """

    backend: str
    trust_region_strategy_type: str
    ordering: str
    num_threads: int

    @property
    def name(self) -> str:
        """Return a name such as "fused amd gauss-newton"."""
        words = (self.backend, self.ordering, self.trust_region_strategy_type.replace("_", "-"))
        return " ".join(filter(None, words))

    def options(self, base: PoseGraphOptions) -> PoseGraphOptions:
        """Return the options of a solve by this method."""
        return base.replace(
            backend=self.backend,
            trust_region_strategy_type=self.trust_region_strategy_type,
            ordering=self.ordering or "auto",
            num_threads=self.num_threads,
        )


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
    runner = Runner(repeat, timeout, progress)
    methods = _methods(
        ("fused",) if orders_only else _listed("backends", backends),
        _listed("threads", threads),
        options.loss,
        TRUST_REGIONS[:1] if orders_only else TRUST_REGIONS,
    )
    # The start is computed once, because all methods must share it.
    started = solve_pose_graph(source, options.replace(max_num_iterations=0)).problem
    base = options.replace(init="file")
    predicted = _predicted(started, methods)
    return runner.compare(
        started,
        options,
        methods,
        lambda method: _solver(started, method.options(base)),
        lambda method: predicted.get(method, math.nan),
        lambda method: _command(started, options, method),
    )


class Runner:
    """Checked settings of a comparison, and its runs.

    Args:
        repeat: solves of each method.
        timeout: seconds after which a solve is stopped.
        progress: called with the name of each method.
    """

    def __init__(self, repeat: int, timeout: float, progress: Callable[[str], None] | None) -> None:
        self.repeat = checked_number("repeat", repeat, whole=True, minimum=1)
        self.timeout = checked_number("timeout", timeout, above=0)
        check_function("progress", progress)
        self.progress = progress

    def compare(
        self,
        graph: PoseGraph | FactorGraph,
        options: PoseGraphOptions | SolveOptions,
        methods: Iterable[Any],
        solver: Callable[[Any], Solve],
        predicted: Callable[[Any], float],
        command: Callable[[Any], str],
    ) -> GraphComparison:
        """Solve by each method, and recommend one.

        Args:
            graph: common start.
            options: options of every solve.
            methods: methods, objects with a ``name``.
            solver: function of a method that returns its solve.
            predicted: predicted seconds of a step of a method; NaN if unknown.
            command: command of a method.
        """
        environment = Environment.now()
        runs = []
        for method in methods:
            if self.progress is not None:
                self.progress(method.name)
            time = predicted(method)
            runs.append(measure(method, solver(method), self.repeat, self.timeout, time))
        best, reason = recommend_run(runs)
        return GraphComparison(
            graph=graph,
            options=options,
            runs=tuple(runs),
            recommended=best.method if best else None,
            reason=reason,
            command=command(best.method) if best else "",
            warnings=best.warnings if best else (),
            repeat=self.repeat,
            timeout=self.timeout,
            environment=environment.finished(),
        )


def check_not_varied(options: Any, defaults: Any, varied: Iterable[str]) -> None:
    """Refuse options that the methods of a comparison vary."""
    for name in varied:
        if getattr(options, name) != getattr(defaults, name):
            raise InputError(f"{name}: expected its default, because it is compared")


def _predicted(graph: PoseGraph, methods: Iterable[GraphMethod]) -> dict[GraphMethod, float]:
    """Return the predicted time of a step of the methods of the fused backend."""
    times: dict[int, dict[str, float]] = {}
    found = {}
    for method in methods:
        if method.backend == "fused":
            if method.num_threads not in times:
                costs = inspect_pose_graph(graph, method.num_threads).costs
                times[method.num_threads] = {
                    cost.ordering: cost.time_per_step_in_seconds for cost in costs
                }
            found[method] = times[method.num_threads][method.ordering]
    return found


def _solver(graph: PoseGraph, options: PoseGraphOptions) -> Solve:
    def solve(progress: Callable[[Any], None]) -> tuple[PoseGraphResult, float]:
        result = solve_pose_graph(graph, options, progress=progress)
        return result, result.summary.chi2_final

    return solve


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
    """Return the command, without options that a solve would choose by itself."""
    chosen = method.options(options)
    held, _, _ = _core.hold_poses(graph)
    if chosen.num_threads == _core.hardware_threads():
        chosen = chosen.replace(num_threads=0)
    if chosen.backend == "fused":
        chosen = chosen.replace(backend="auto")
    if method.ordering == _core.auto_ordering(graph, held):
        chosen = chosen.replace(ordering="auto")
    return command_line(chosen, graph.path or "INPUT")


NEAR_ENOUGH = 1.15
"""Factor of the shortest time within which methods count as equally fast."""

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
    times_in_seconds: tuple[float, ...]
    final_cost: float
    chi2_final: float
    num_steps: int
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
    method: Any,
    solve: Solve,
    repeat: int,
    timeout: float,
    predicted: float = math.nan,
) -> GraphRun:
    """Solve several times by one method.

    ``timeout``: seconds after which a solve is stopped. ``predicted``: predicted time of a step in
    seconds.
    """
    times: list[float] = []
    for _ in range(repeat):
        begun = time.perf_counter()

        def watch(_: Any, begun: float = begun) -> None:
            if time.perf_counter() - begun > timeout:
                raise _TimeoutError

        try:
            result, chi2 = solve(watch)
        except _TimeoutError:
            return _failed(method, "TIMEOUT", f"stopped after {number(timeout)} s")
        except InputError:
            raise
        except (RuntimeError, MemoryError) as error:
            return _failed(method, "FAILURE", str(error).partition("\n")[0] or "no memory")
        summary = result.summary
        if summary.interrupted:
            raise KeyboardInterrupt
        if not summary.is_solution_usable:
            return _failed(method, summary.termination_type, summary.message)
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


def _failed(method: Any, termination: str, failure: str) -> GraphRun:
    return GraphRun(
        method=method,
        times_in_seconds=(),
        final_cost=math.nan,
        chi2_final=math.nan,
        num_steps=0,
        termination_type=termination,
        failure=failure,
    )


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
        f"{first.method.name} took {seconds(first.time_in_seconds)} s to cost "
        f"{best:.6g}: the least time, or within {round(100 * (NEAR_ENOUGH - 1))} % of "
        f"it, of the {plural(len(good), 'method')} with the lowest cost"
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
