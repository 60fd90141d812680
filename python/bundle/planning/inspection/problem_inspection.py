"""Predicted cost of each solver method, from the pattern of a problem."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any, Unpack, overload

import bundle._core as _core
from bundle.base.arrays import as_flag
from bundle.base.words import SHARE_OF_FREE_MEMORY
from bundle.errors import InputError
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.same_problem import options_of_graph, pose_graph_of, problem_of
from bundle.graphs.pose_graphs.edge_weights import is_graph, refuse_for_graphs
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.option_class import takes_options
from bundle.interface.options import SolveOptions
from bundle.io.files import Source, as_problem
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.planning.inspection.elimination_costs import (
    FactorGraphInspection,
    inspect_factor_graph,
    inspect_pose_graph,
)
from bundle.planning.inspection.inspection_result import (
    Inspection,
    Method,
    MethodInspection,
    all_methods,
    explain,
    recommend,
)
from bundle.planning.inspection.machine_rates import Rates
from bundle.planning.inspection.peak_memory import (
    FactorCounter,
    FactorizedSystem,
    Terms,
    ceres_memory,
    fused_memory,
    total,
)
from bundle.planning.inspection.problem_pattern import ProblemPattern, find_pattern
from bundle.planning.inspection.problem_time import (
    ceres_work,
    fused_work,
    implicit_work,
    passes_per_step,
    problem_rates,
    products_per_step,
)
from bundle.solving.layout import resolve_defaults

if TYPE_CHECKING:
    from bundle.interface.option_keywords import SolveKeywords


@overload
def inspect(
    problem: PoseGraph | PoseGraphResult, *, recalibrate: bool = False, num_threads: int = 0
) -> FactorGraphInspection: ...


@overload
def inspect(
    problem: FactorGraph,
    options: SolveOptions | None = None,
    *,
    recalibrate: bool = False,
    **changes: Unpack[SolveKeywords],
) -> Inspection | FactorGraphInspection: ...


@overload
def inspect(
    problem: Source,
    options: SolveOptions | None = None,
    *,
    recalibrate: bool = False,
    **changes: Unpack[SolveKeywords],
) -> Inspection: ...


@takes_options(SolveOptions)
def inspect(
    problem: Source | PoseGraph | PoseGraphResult | FactorGraph,
    options: SolveOptions | None = None,
    *,
    recalibrate: bool = False,
    **changes: Unpack[SolveKeywords],
) -> Inspection | FactorGraphInspection:
    """Predict the cost of each solver method on a problem, without solving it.

    Counts are exact, by symbolic elimination on blocks, unless a method's note says otherwise.
    Times are counts multiplied by the rates of this machine. The first call measures the rates in a
    second or two.

    For a pose graph, the result of its solve, or a g2o file, the result is a
    :class:`FactorGraphInspection`: nonzeros of the normal equations, and fill-in, flops and memory
    of their factor in each elimination order, with the predicted time of a step. Of the options,
    pose graphs take only ``num_threads``.

    A :class:`FactorGraph` of reprojections is inspected as the problem that it represents, one of
    relative poses as the pose graph; the result is equal. For any other factor graph the result is
    a :class:`FactorGraphInspection`, with the same table of orders. The graph decides which
    coordinates are constant; only ``num_threads`` of the options has an effect.

    Args:
        problem: Problem, path of one, or pycolmap.Reconstruction; not modified.
        options: refined parameters and number of threads; their choice of solver has no effect.
        recalibrate: measure the rates of this machine again.
        **changes: options by name, which replace those in ``options``.

    Raises:
        InputError: an option or a fixed id does not exist, a camera model is not supported, or no
            observations constrain the refined parameters.
        OSError: the path cannot be read.
    """
    if isinstance(problem, FactorGraph):
        return _inspect_factor_graph(problem, options, recalibrate=recalibrate, **changes)
    if is_graph(problem):
        threads = _only_threads(options, changes)
        return inspect_pose_graph(problem, threads, recalibrate=as_flag("recalibrate", recalibrate))
    problem = as_problem(problem)  # type: ignore[arg-type]
    recalibrate = as_flag("recalibrate", recalibrate)
    chosen = resolve_defaults(problem, SolveOptions.of(options, changes, "inspect"))
    pattern = find_pattern(problem, chosen)
    rates = problem_rates(chosen.num_threads, recalibrate=recalibrate)
    inspector = _Inspector(problem, chosen, pattern, rates)
    methods = tuple(inspector.inspect(method) for method in inspector.methods())
    best = recommend(methods)
    columns = pattern.num_camera_columns
    density = pattern.reduced.nnz / columns**2 if columns else 1.0
    return Inspection(
        num_observations=pattern.num_observations,
        num_free_points=pattern.num_free_points,
        num_camera_columns=columns,
        num_camera_blocks=len(pattern.reduced.sizes),
        reduced_density=density,
        num_threads=chosen.num_threads,
        available_memory_in_bytes=inspector.available_memory,
        methods=methods,
        recommended=best,
        recommendation=explain(methods, best, density),
        auto_choice=inspector.auto_choice(),
    )


def _inspect_factor_graph(
    graph: FactorGraph,
    options: SolveOptions | None,
    *,
    recalibrate: bool,
    **changes: Unpack[SolveKeywords],
) -> Inspection | FactorGraphInspection:
    """Inspect the pose graph or problem that a factor graph represents, otherwise the graph."""
    if (same := problem_of(graph)) is not None:
        asked = options_of_graph(same, SolveOptions.of(options, changes, "inspect"))
        return inspect(same.problem, asked, recalibrate=recalibrate)
    threads = _only_threads(options, changes)
    poses = pose_graph_of(graph)
    if poses is None:
        return inspect_factor_graph(graph, threads, recalibrate=recalibrate)
    return inspect_pose_graph(poses.graph, threads, recalibrate=recalibrate)


def _only_threads(options: SolveOptions | None, changes: Mapping[str, Any]) -> int:
    """Return the number of threads; refuse all other options, which a graph does not have."""
    others = {name: value for name, value in changes.items() if name != "num_threads"}
    refuse_for_graphs(options=options, **others)
    return SolveOptions.of(None, changes, "inspect").num_threads


class _Inspector:
    """Counts and predictions of each method on one problem."""

    def __init__(
        self, problem: Problem, options: SolveOptions, pattern: ProblemPattern, rates: Rates
    ) -> None:
        self.available_memory = _core.available_memory()
        self._pattern = pattern
        self._rates = rates
        self._num_threads = options.num_threads
        self._counter = FactorCounter(problem, options, pattern)

    def methods(self) -> tuple[Method, ...]:
        """Return the methods that apply to this problem."""
        pattern = self._pattern
        if pattern.num_unknowns == 0 or pattern.num_observations == 0:
            raise InputError("refine: expected observations of the refined parameters, found 0")
        every = all_methods()
        if pattern.num_free_points == 0 or pattern.num_camera_columns == 0:  # nothing to eliminate
            taken = "FUSED" if pattern.num_camera_columns else None
            return tuple(
                method
                for method in every
                if method.linear_solver_type == "SPARSE_NORMAL_CHOLESKY" or method.backend == taken
            )
        if pattern.longest_track > _core.MAX_TRACK_LENGTH:
            return tuple(method for method in every if method.backend == "CERES")
        return every

    def auto_choice(self) -> str:
        """Return the linear solver that the fused backend would choose; "" if it has no method."""
        return self._auto[0]

    @cached_property
    def _auto(self) -> tuple[str, bool]:
        """Choice of ``auto``; True if it is conjugate gradients without forming S."""
        if all(method.backend == "CERES" for method in self.methods()):
            return "", False
        pattern = self._pattern
        return _core.auto_choice(
            *pattern.reduced, self._num_threads, pattern.num_observations, pattern.num_pairs
        )

    def _leaves_out_system(self, method: Method) -> bool:
        """Return True if a solve by the method would not form S (``fused_solver.cpp``)."""
        is_local = method.preconditioner in ("IDENTITY", "JACOBI", "SCHUR_JACOBI")
        return method.backend == "FUSED" and is_local and self._auto[1]

    def inspect(self, method: Method) -> MethodInspection:
        """Return the counts and predictions of one method."""
        pattern = self._pattern
        counted = self._count(method)
        count = counted.factor if counted else None
        memory, time = self._predict(method, counted)
        bytes_needed = total(memory)
        fits = bytes_needed <= SHARE_OF_FREE_MEMORY * self.available_memory
        makes_reduced = not (
            method.linear_solver_type == "SPARSE_NORMAL_CHOLESKY" or self._leaves_out_system(method)
        )
        return MethodInspection(
            name=method.name,
            linear_solver_type=method.linear_solver_type,
            backend=method.backend,
            ordering=method.ordering,
            preconditioner=method.preconditioner,
            num_unknowns=pattern.num_unknowns,
            nnz_jacobian=pattern.nnz_jacobian,
            nnz_information=pattern.nnz_information,
            nnz_reduced=(counted.nnz_reduced if counted else pattern.reduced.nnz)
            if makes_reduced
            else 0,
            nnz_factor=count.nnz if count else 0,
            fill=count.fill if count else 0,
            flops=count.flops if count else 0.0,
            cholmod_flops=count.cholmod_flops if count else 0.0,
            tree_height=count.tree_height if count else 0,
            column_count_profile=count.profile if count else (),
            memory_in_bytes=bytes_needed,
            memory_terms=memory,
            time_per_step_in_seconds=total(time),
            time_terms=time,
            fits_in_memory=fits,
            is_taken=self._is_taken(method),
            note=self._note(method, counted),
        )

    def _count(self, method: Method) -> FactorizedSystem | None:
        """Return the system that a method factorises; None without a factorisation."""
        if method.linear_solver_type == "DENSE_SCHUR":
            return self._counter.dense()
        if method.linear_solver_type == "SPARSE_NORMAL_CHOLESKY":
            return self._counter.whole()
        if method.preconditioner:
            return None
        if method.ordering == "cameras_first":
            return self._counter.cameras_first()
        return self._counter.sparse(method.ordering)

    def _predict(self, method: Method, counted: FactorizedSystem | None) -> tuple[Terms, Terms]:
        pattern, kind = self._pattern, method.linear_solver_type
        threads, products = self._num_threads, products_per_step(method.preconditioner)
        if method.backend == "CERES":
            work = ceres_work(pattern, kind, counted, threads, products)
            return ceres_memory(pattern, kind, counted), self._rates.terms(work)
        if self._leaves_out_system(method):
            memory = fused_memory(pattern.without_system(), kind, counted, threads)
            return memory, self._rates.terms(implicit_work(pattern))
        coarse, forming = 0.0, {}
        if method.preconditioner == "TWO_LEVEL":
            coarse = COARSE_FACTOR_SHARE * self._counter.sparse(self._taken_by_fused()).factor.nnz
            values = pattern.num_reduced_values / threads
            forming = {"coarse system": _SECONDS_PER_COARSE_VALUE * values} if coarse else {}
        work = fused_work(pattern, kind, counted, threads, products, coarse)
        memory = fused_memory(pattern, kind, counted, threads, coarse)
        return memory, self._rates.terms(work) | forming

    def _note(self, method: Method, counted: FactorizedSystem | None) -> str:
        if self._leaves_out_system(method):
            passes = round(passes_per_step(self._pattern))
            return (
                f"does not form S, and assumes {passes} passes over the observations per step; the "
                "actual number depends on the values"
            )
        if counted is None:
            products = products_per_step(method.preconditioner)
            return (
                f"assumes {products} products with S per step; the actual number depends on the "
                "values"
            )
        if not method.backend:
            return "for comparison: neither backend offers this order"
        if not self._is_taken(method):
            return f"the fused backend selects {self._taken_by_fused()}, which needs fewer flops"
        return counted.note

    def _is_taken(self, method: Method) -> bool:
        if method.linear_solver_type == "SPARSE_SCHUR" and method.backend == "FUSED":
            return method.ordering == self._taken_by_fused()
        return method.backend != ""

    def _taken_by_fused(self) -> str:
        """Return the cheapest of the orders that supernodes.cpp tries; ties go to the first."""
        tried = ("natural", "amd", "metis", "minimum_fill")
        return min(tried, key=lambda name: self._counter.sparse(name).factor.cholmod_flops)


# Coarse system of TWO_LEVEL: seconds to form it per value of S and thread, and nnz of its factor
# relative to nnz(L). Both as in choose_solver.cpp.
_SECONDS_PER_COARSE_VALUE, COARSE_FACTOR_SHARE = 10e-9, 0.05
