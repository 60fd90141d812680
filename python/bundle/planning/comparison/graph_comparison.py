"""Comparison of solver methods on a pose graph, with one recommendation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import bundle._core as _core
from bundle.base.arguments import check_function, check_type
from bundle.base.display import Display, Displayed
from bundle.base.paths import as_path, is_path
from bundle.base.records import dataclass
from bundle.base.words import plural, seconds
from bundle.errors import InputError
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.pose_graphs.edge_weights import check_free_pose, check_information_exists
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.graphs.pose_graphs.solve_pose_graph import solve_pose_graph
from bundle.interface.compare_options import BACKENDS, REPEAT, TIMEOUT
from bundle.interface.environment import Environment
from bundle.interface.option_fields import choice
from bundle.interface.option_fields import number as checked_number
from bundle.interface.options import SolveOptions
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.tabular import Tabular
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.comparison.graph_distance import graph_distance
from bundle.planning.comparison.graph_runs import GraphRun, best_cost, measure, recommend_run
from bundle.planning.comparison.method import as_tuple, thread_counts
from bundle.planning.comparison.recommendation import command_line
from bundle.planning.inspection.pose_graph_inspection import inspect_pose_graph

__all__ = ["FactorGraphMethod", "GraphComparison", "GraphMethod", "GraphRun", "compare_graph"]

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


@dataclass(frozen=True, kw_only=True)
class FactorGraphMethod:
    """Options of a compared solve of a factor graph, named as in :class:`bundle.SolveOptions`.

    ``linear_solver_type`` is "square_root" for a QR factorisation of the Jacobian.
    """

    linear_solver_type: str
    trust_region_strategy_type: str
    num_threads: int

    @property
    def name(self) -> str:
        """Return a name such as "sparse-normal-cholesky dogleg"."""
        words = (self.linear_solver_type, self.trust_region_strategy_type)
        return " ".join(words).replace("_", "-")

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of :meth:`bundle.FactorGraph.solve`."""
        of_solver: dict[str, Any] = {"linear_solver_type": self.linear_solver_type}
        if self.linear_solver_type == "square_root":
            of_solver = {"square_root": True}
        return {
            **of_solver,
            "trust_region_strategy_type": self.trust_region_strategy_type,
            "num_threads": self.num_threads,
        }


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

    Raises:
        InputError: an argument is invalid, an option is compared, all poses are constant, or all
            information is 0.
        OSError: the path cannot be read.
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
    defaults = PoseGraphOptions()
    for name in VARIED:
        if getattr(options, name) != getattr(defaults, name):
            raise InputError(f"{name}: expected its default, because it is compared")
    if options.loss == "auto":
        raise InputError("loss: expected a named loss to compare methods with, found auto")
    repeat = checked_number("repeat", repeat, whole=True, minimum=1)
    timeout = checked_number("timeout", timeout, above=0)
    check_function("progress", progress)
    methods = _methods(
        ("fused",) if orders_only else _listed("backends", backends),
        _listed("threads", threads),
        options.loss,
        TRUST_REGIONS[:1] if orders_only else TRUST_REGIONS,
    )
    environment = Environment.now()
    # The start is computed once, because all methods must share it.
    started = solve_pose_graph(source, options.replace(max_num_iterations=0)).problem
    base = options.replace(init="file")
    predicted = _predicted(started, methods)
    runs = []
    for method in methods:
        if progress is not None:
            progress(method.name)
        solve = _solver(started, method.options(base))
        runs.append(measure(method, solve, repeat, timeout, predicted.get(method, math.nan)))
    best, reason = recommend_run(runs)
    return GraphComparison(
        graph=started,
        options=options,
        runs=tuple(runs),
        recommended=best.method if best else None,
        reason=reason,
        command=_command(started, options, best.method) if best else "",
        warnings=best.warnings if best else (),
        repeat=repeat,
        timeout=timeout,
        environment=environment.finished(),
    )


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


def _solver(
    graph: PoseGraph, options: PoseGraphOptions
) -> Callable[[Callable[[Any], None]], tuple[PoseGraphResult, float]]:
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
