"""Result of ``bundle.inspect``: predicted cost of each solver method, and the recommended one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field

import bundle._core as _core
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import format_size, number, plural
from bundle.interface.options import PRECONDITIONER_TYPES
from bundle.interface.tabular import Tabular
from bundle.planning.inspection.peak_memory import Terms


@dataclass(frozen=True, kw_only=True)
class EliminationCost:
    """Exact cost of the Cholesky factor L in one order of the variables.

    Attributes:
        ordering: "natural" (by position), "amd", "metis", "colamd", "nesdis", or "dense" for a
            dense matrix; "" for a method without a factorisation, whose counts are 0.
        nnz_factor: nnz(L): lower triangle with its diagonal, without the zeros that supernodes
            store.
        fill: fill-in: pairs of variables or blocks that are nonzero in L and zero in the matrix.
        flops: sum of c^2 + 3 c over the columns of L with c entries below the diagonal.
        tree_height: variables or blocks on the longest path of the elimination tree.
        memory_in_bytes: memory of the values of L, of a dense matrix with both triangles; of a
            method the peak memory beyond the loaded problem.
        is_taken: True if an option of the solve selects the order or the method. The fused backend
            always takes the cheapest of four orders of S.
        time_per_step_in_seconds: predicted time of a trust region step; NaN if unknown.
        time_terms: parts of this time.
    """

    ordering: str
    nnz_factor: int
    fill: int
    flops: float
    tree_height: int
    memory_in_bytes: float
    is_taken: bool = True
    time_per_step_in_seconds: float = math.nan
    time_terms: Terms = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MethodInspection(Displayed, EliminationCost):
    """Predicted cost of one method: that of its factor, and more.

    Nonzeros of J, of the information matrix and of S count both triangles and the diagonal; those
    of L count its lower triangle with the diagonal.

    Attributes:
        name: such as "SPARSE_SCHUR amd".
        linear_solver_type: Ceres' name.
        backend: "FUSED", "CERES", or "" for an order that neither backend offers, listed for
            comparison; its time and memory are predicted as for the fused backend.
        preconditioner: Ceres' name; "" for direct solvers.
        num_unknowns: number of refined scalars.
        nnz_jacobian, nnz_information, nnz_reduced: nonzeros of J, J^T J and S; 0 where S is not
            formed.
        cholmod_flops: sum of (c + 1)^2, CHOLMOD's own estimate; 0 without a factor.
        column_count_profile: largest c of up to 200 equal portions of the columns of L, in
            elimination order.
        memory_terms: terms of the memory in bytes.
        fits_in_memory: True if the memory is at most 90 % of the free memory.
        note: remark on the numbers; may be "".
    """

    name: str
    linear_solver_type: str
    backend: str
    preconditioner: str
    num_unknowns: int
    nnz_jacobian: int
    nnz_information: int
    nnz_reduced: int
    cholmod_flops: float
    column_count_profile: tuple[int, ...]
    memory_terms: Terms
    fits_in_memory: bool
    note: str

    @property
    def backend_name(self) -> str:
        """Name of the backend for display; "-" for an order that neither backend offers."""
        return {"FUSED": "fused", "CERES": "Ceres"}.get(self.backend, "-")

    def _display(self) -> Display:
        facts = [
            ("backend", self.backend_name),
            ("unknowns", str(self.num_unknowns)),
            ("nonzeros of L", number(self.nnz_factor) if self.nnz_factor else "-"),
            ("flops", number(self.flops) if self.flops else "-"),
            ("memory", format_size(self.memory_in_bytes)),
            ("time per step", f"{number(self.time_per_step_in_seconds)} s"),
        ]
        if not self.fits_in_memory:
            facts.append(("", "does not fit into the free memory"))
        if self.note:
            facts.append(("note", self.note))
        return Display(title=f"MethodInspection: {self.name}", facts=tuple(facts))


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Inspection(Displayed, Tabular):
    """Predicted cost of solving a problem by each method.

    Attributes:
        num_observations: observations of refined parameters.
        num_free_points, num_camera_columns, num_camera_blocks: counts of the unknowns.
        reduced_density: share of nonzeros in S; 1.0 if no camera parameter is refined.
        num_threads: threads for which times are predicted.
        available_memory_in_bytes: free memory of the machine.
        methods: predicted cost of each method.
        recommended: index into ``methods`` of the fastest that fits into memory; -1 if none fits.
        recommendation: recommended method and reason in one sentence.
        auto_choice: linear solver that the fused backend's ``auto`` chooses by its own rates
            (cpp/core/prepare/choose_solver.cpp); "" if the fused backend cannot solve the problem.
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

    def _display(self) -> Display:
        unknowns = self.methods[0].num_unknowns if self.methods else 0
        facts = (
            ("problem", plural(self.num_observations, "observation")),
            ("unknowns", f"{unknowns}, including {plural(self.num_free_points, 'point')}"),
            ("recommended", self.recommendation),
        )
        rows = tuple(
            (
                f"{'* ' if index == self.recommended else '  '}{method.name}",
                method.backend_name,
                number(method.nnz_factor) if method.nnz_factor else "-",
                number(method.flops) if method.flops else "-",
                format_size(method.memory_in_bytes),
                number(method.time_per_step_in_seconds),
            )
            for index, method in enumerate(self.methods)
        )
        return Display(
            title=f"Inspection: predicted cost on {plural(self.num_threads, 'thread')}",
            facts=facts,
            head=("  method", "backend", "nonzeros of L", "flops", "memory", "s per step"),
            rows=rows,
        )


ORDERINGS = ("natural", "amd", "colamd", "metis", "nesdis", "minimum_fill")
"""Orders of the blocks of S, as a report lists them."""

_CERES_ALONE = ("cluster_jacobi", "cluster_tridiagonal")
_FUSED_ALONE = ("two_level",)
_FIRST_CERES_WITH_POWER_SERIES = (2, 2)


@dataclass(frozen=True, kw_only=True)
class Method:
    """Linear solver (Ceres' name) with its backend, order and preconditioner."""

    linear_solver_type: str
    backend: str  # "FUSED", "CERES", or "" for an order that neither backend offers
    # order of the factorised blocks; "" without a factorisation. "cameras_first" eliminates the
    # cameras and orders the points by AMD
    ordering: str = ""
    preconditioner: str = ""  # "" for direct solvers

    @property
    def name(self) -> str:
        """Return a name such as "SPARSE_SCHUR amd"."""
        what = self.preconditioner.lower() if self.preconditioner else self.ordering
        return f"{self.linear_solver_type} {what}".strip()


def all_methods() -> tuple[Method, ...]:
    """Return the methods as a report lists them."""
    methods = [Method(linear_solver_type="DENSE_SCHUR", backend="FUSED", ordering="natural")]
    methods.append(Method(linear_solver_type="DENSE_SCHUR", backend="CERES", ordering="natural"))
    for ordering in ORDERINGS:
        for backend in _who_takes(ordering):
            methods.append(
                Method(linear_solver_type="SPARSE_SCHUR", backend=backend, ordering=ordering)
            )
    methods.append(
        Method(linear_solver_type="SPARSE_SCHUR", backend="CERES", ordering="cameras_first")
    )
    methods.append(
        Method(linear_solver_type="SPARSE_NORMAL_CHOLESKY", backend="CERES", ordering="amd")
    )
    for preconditioner in PRECONDITIONER_TYPES:
        for backend in _who_has(preconditioner):
            methods.append(
                Method(
                    linear_solver_type="ITERATIVE_SCHUR",
                    backend=backend,
                    preconditioner=preconditioner.upper(),
                )
            )
    return tuple(methods)


def _who_takes(ordering: str) -> tuple[str, ...]:
    """Return the backends that offer an order of S (supernodes.cpp, Ceres' defaults)."""
    if ordering == "amd":
        return ("FUSED", "CERES")
    return ("FUSED",) if ordering in ("natural", "metis", "minimum_fill") else ("",)


def _who_has(preconditioner: str) -> tuple[str, ...]:
    version = tuple(int(part) for part in _core.CERES_VERSION.split(".")[:2])
    if preconditioner in _CERES_ALONE:
        return ("CERES",)
    if preconditioner in _FUSED_ALONE:
        return ("FUSED",)
    is_new = preconditioner == "schur_power_series_expansion"
    if is_new and version < _FIRST_CERES_WITH_POWER_SERIES:
        return ("FUSED",)
    return ("FUSED", "CERES")


def recommend(methods: Sequence[MethodInspection]) -> int:
    """Return the index of the fastest method that is available and fits; -1 if none fits."""
    usable = [i for i, method in enumerate(methods) if method.is_taken and method.fits_in_memory]
    return min(usable, key=lambda i: methods[i].time_per_step_in_seconds, default=-1)


def explain(methods: Sequence[MethodInspection], best: int, density: float) -> str:
    """Return the recommendation and its reason as a sentence; ``density`` is that of S."""
    if best < 0:
        least = min(methods, key=lambda method: method.memory_in_bytes)
        return (
            f"No method fits into the free memory; {least.name} needs the least, "
            f"{format_size(least.memory_in_bytes)}."
        )
    chosen = methods[best]
    reasons = [f"S is {_two_digits(100 * density)} % full"]
    if chosen.ordering:
        order = (
            ""
            if chosen.linear_solver_type == "DENSE_SCHUR"
            else f"the {chosen.ordering} order needs "
        )
        reasons.append(f"{order}{chosen.flops:.2g} flops per step")
    else:
        reasons.append("no factorisation")
    rival = _rival(methods, chosen)
    if rival is not None:
        reasons.append(_against(rival, chosen))
    return f"{chosen.linear_solver_type}: {', '.join(reasons)}."


def _rival(
    methods: Sequence[MethodInspection], chosen: MethodInspection
) -> MethodInspection | None:
    """Return the best method with another linear solver, with the same backend if possible."""
    others = [
        method
        for method in methods
        if method.is_taken
        and method.linear_solver_type != chosen.linear_solver_type
        and method.backend == chosen.backend
    ]
    direct = [method for method in others if method.nnz_factor > 0]
    return min(direct or others, key=lambda m: m.time_per_step_in_seconds, default=None)


def _against(rival: MethodInspection, chosen: MethodInspection) -> str:
    name = rival.linear_solver_type
    if not rival.fits_in_memory:
        return f"{name} needs {format_size(rival.memory_in_bytes)}, more than the free memory"
    times = rival.time_per_step_in_seconds / chosen.time_per_step_in_seconds
    if chosen.flops and rival.flops > 1.05 * chosen.flops:
        more = rival.flops / chosen.flops
        return f"{name} needs {_two_digits(more)} times the flops and takes {_as_long(times)}"
    return f"{name} takes {_as_long(times)}"


def _as_long(times: float) -> str:
    return "as long" if times < 1.05 else f"{_two_digits(times)} times as long"


def _two_digits(value: float) -> str:
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"
