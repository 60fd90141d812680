"""What each way to solve a problem costs, from its pattern alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from bundle import _core
from bundle.errors import InputError
from bundle.inspection.counts import Counted, Counter
from bundle.inspection.memory import Terms, ceres_memory, fused_memory, total
from bundle.inspection.methods import Method, all_methods
from bundle.inspection.problem_pattern import ProblemPattern, find_pattern
from bundle.inspection.rates import Rates, machine_rates
from bundle.inspection.recommend import explain, recommend
from bundle.inspection.step_time import (
    COARSE_FACTOR_SHARE,
    ceres_time,
    fused_time,
    products_per_step,
)
from bundle.options import SolveOptions
from bundle.problem import Problem
from bundle.solver import resolve_defaults

__all__ = ["SHARE_OF_MEMORY", "Inspection", "MethodInspection", "inspect"]

SHARE_OF_MEMORY = 0.9
"""Of the memory that is free, how much a method may take."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodInspection:
    """What one method is predicted to cost.

    Nonzeros of J, of the information matrix and of S count both triangles and the diagonal; those
    of L count its lower triangle with the diagonal.

    Attributes:
        name: "SPARSE_SCHUR amd".
        linear_solver_type: Ceres' name.
        backend: "FUSED", "CERES", or "": neither takes this order, which is here to be compared;
            time and memory are then those of the fused backend.
        ordering: of what is factorised; "" where nothing is.
        preconditioner: Ceres' name, "" for direct solvers.
        num_unknowns: refined numbers.
        nnz_jacobian, nnz_information, nnz_reduced: of J, J^T J and S; S is 0 where it is not made.
        nnz_factor: of L; 0 without a factor, and so the next four.
        fill: pairs of blocks that L has and the matrix has not.
        flops: sum of c^2 + 3 c over the columns of L, c entries below the diagonal.
        cholmod_flops: sum of (c + 1)^2, CHOLMOD's own estimate.
        tree_height: blocks on the longest path of the elimination tree.
        column_count_profile: largest c of up to 200 equal portions of the columns of L, in
            elimination order.
        memory_in_bytes: peak beyond the loaded problem.
        memory_terms: what it is made of, in bytes.
        time_per_step_in_seconds: of a step of the trust region.
        time_terms: what it is made of, in seconds.
        fits_in_memory: whether the machine has that much free, with a tenth to spare.
        is_taken: whether a solve can be made to do this. The fused backend takes the cheapest of
            three orders, whatever the others cost.
        note: what is to be known about the numbers, "" if nothing.
    """

    name: str
    linear_solver_type: str
    backend: str
    ordering: str
    preconditioner: str
    num_unknowns: int
    nnz_jacobian: int
    nnz_information: int
    nnz_reduced: int
    nnz_factor: int
    fill: int
    flops: float
    cholmod_flops: float
    tree_height: int
    column_count_profile: tuple[int, ...]
    memory_in_bytes: float
    memory_terms: Terms
    time_per_step_in_seconds: float
    time_terms: Terms
    fits_in_memory: bool
    is_taken: bool
    note: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Inspection:
    """What is known of a problem before it is solved.

    Attributes:
        num_observations: those with something to refine.
        num_free_points, num_camera_columns, num_camera_blocks: of the unknowns.
        reduced_density: share of S that is not zero, by nonzeros; 1.0 without a camera side.
        num_threads: that the times are for.
        available_memory_in_bytes: of the machine, now.
        methods: what each costs.
        recommended: index into methods of the fastest that fits; -1 if none does.
        recommendation: the same in a sentence, with its reason.
        auto_choice: linear solver that the fused backend's ``auto`` takes, which goes by rates of
            its own (cpp/core/fused/reduced/reduced_cost.cpp); "" where it does not come into it.
    """

    num_observations: int
    num_free_points: int
    num_camera_columns: int
    num_camera_blocks: int
    reduced_density: float
    num_threads: int
    available_memory_in_bytes: float
    methods: tuple[MethodInspection, ...]
    recommended: int
    recommendation: str
    auto_choice: str


def inspect(
    problem: Problem,
    options: SolveOptions | None = None,
    *,
    recalibrate: bool = False,
    **changes: Any,
) -> Inspection:
    """Predict what each way to solve a problem costs, without solving it.

    Counts are exact, by elimination on the blocks, unless a method's note says otherwise. Times are
    counts times the rates of this machine, measured in a second when they are first needed.

    Args:
        problem: left untouched.
        options: what is refined and by how many threads; which solver they name does not matter.
        recalibrate: measure the rates of this machine again.
        **changes: options by name, in place of those in ``options``.

    Raises:
        InputError: a camera model that is not supported, a fixed id that does not exist, or no
            observations of anything that is refined.
    """
    chosen = resolve_defaults(problem, (options or SolveOptions()).replace(**changes))
    pattern = find_pattern(problem, chosen)
    rates = machine_rates(chosen.num_threads, recalibrate=recalibrate)
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


class _Inspector:
    """One problem's methods, each counted and predicted."""

    def __init__(
        self, problem: Problem, options: SolveOptions, pattern: ProblemPattern, rates: Rates
    ) -> None:
        self.available_memory = _core.available_memory()
        self._pattern = pattern
        self._rates = rates
        self._num_threads = options.num_threads
        self._counter = Counter(problem, options, pattern)

    def methods(self) -> tuple[Method, ...]:
        """Return the methods that there are for this problem.

        Raises:
            InputError: nothing is refined.
        """
        pattern = self._pattern
        if pattern.num_unknowns == 0 or pattern.num_observations == 0:
            raise InputError("refine: expected observations of what is refined, found none")
        every = all_methods()
        if pattern.num_free_points == 0 or pattern.num_camera_columns == 0:  # nothing to eliminate
            return tuple(m for m in every if m.linear_solver_type == "SPARSE_NORMAL_CHOLESKY")
        if pattern.longest_track > _core.MAX_TRACK_LENGTH:
            return tuple(method for method in every if method.backend == "CERES")
        return every

    def auto_choice(self) -> str:
        """Return the linear solver that the fused backend would choose, "" if it cannot."""
        if all(method.backend == "CERES" for method in self.methods()):
            return ""
        return _core.auto_choice(*self._pattern.reduced, self._num_threads)

    def inspect(self, method: Method) -> MethodInspection:
        """Return the counts and predictions of one method."""
        pattern = self._pattern
        counted = self._count(method)
        count = counted.factor if counted else None
        memory, time = self._predict(method, counted)
        bytes_needed = total(memory)
        fits = bytes_needed <= SHARE_OF_MEMORY * self.available_memory
        makes_reduced = method.linear_solver_type != "SPARSE_NORMAL_CHOLESKY"
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

    def _count(self, method: Method) -> Counted | None:
        """Return what a method factorises, None if nothing."""
        if method.linear_solver_type == "DENSE_SCHUR":
            return self._counter.dense()
        if method.linear_solver_type == "SPARSE_NORMAL_CHOLESKY":
            return self._counter.whole()
        if method.preconditioner:
            return None
        if method.ordering == "cameras_first":
            return self._counter.cameras_first()
        return self._counter.sparse(method.ordering)

    def _predict(self, method: Method, counted: Counted | None) -> tuple[Terms, Terms]:
        pattern, kind = self._pattern, method.linear_solver_type
        name, rates = method.preconditioner, self._rates
        if method.backend == "CERES":
            memory = ceres_memory(pattern, kind, counted)
            return memory, ceres_time(pattern, kind, name, counted, rates)
        coarse = 0.0
        if name == "TWO_LEVEL":
            coarse = COARSE_FACTOR_SHARE * self._counter.sparse(self._taken_by_fused()).factor.nnz
        memory = fused_memory(pattern, kind, counted, self._num_threads, coarse)
        return memory, fused_time(pattern, kind, name, counted, rates, coarse)

    def _note(self, method: Method, counted: Counted | None) -> str:
        if counted is None:
            products = products_per_step(method.preconditioner)
            return f"takes {products} products with S a step for granted, where 2 to 500 are usual"
        if not method.backend:
            return "for comparison: neither backend takes this order"
        if not self._is_taken(method):
            return f"the fused backend takes {self._taken_by_fused()}, which makes fewer flops"
        return counted.note

    def _is_taken(self, method: Method) -> bool:
        if method.linear_solver_type == "SPARSE_SCHUR" and method.backend == "FUSED":
            return method.ordering == self._taken_by_fused()
        return method.backend != ""

    def _taken_by_fused(self) -> str:
        """Return the cheapest of the orders that fill_ordering.cpp tries, the first of equals."""
        tried = ("natural", "amd", "metis")
        return min(tried, key=lambda name: self._counter.sparse(name).factor.cholmod_flops)
