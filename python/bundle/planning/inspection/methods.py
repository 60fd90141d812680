"""Solver methods that an inspection compares, and the one that it recommends."""

from __future__ import annotations

from collections.abc import Sequence

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.base.words import format_size
from bundle.interface.options import PRECONDITIONER_TYPES
from bundle.planning.inspection.inspection_result import MethodInspection

ORDERINGS = ("natural", "amd", "colamd", "metis", "nesdis")
"""Orders of the blocks of S, as a report lists them."""

_CERES_ALONE = ("cluster_jacobi", "cluster_tridiagonal")
_FUSED_ALONE = ("two_level",)
_FIRST_CERES_WITH_POWER_SERIES = (2, 2)


@dataclass(frozen=True, kw_only=True)
class Method:
    """Linear solver (Ceres' name) with its backend, order and preconditioner.

    Attributes:
        backend: "FUSED", "CERES", or "" for an order that neither backend offers.
        ordering: order of the factorised blocks; "" without a factorisation. "cameras_first"
            eliminates the cameras and orders the points by AMD.
        preconditioner: "" for direct solvers.
    """

    linear_solver_type: str
    backend: str
    ordering: str = ""
    preconditioner: str = ""

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
    return ("FUSED",) if ordering in ("natural", "metis") else ("",)


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
    """Return the best method with another linear solver, of the same backend if possible."""
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
    if chosen.flops and rival.flops > chosen.flops:
        more = rival.flops / chosen.flops
        return f"{name} needs {_two_digits(more)} times the flops and takes {_as_long(times)}"
    return f"{name} takes {_as_long(times)}"


def _as_long(times: float) -> str:
    return "as long" if times < 1.05 else f"{_two_digits(times)} times as long"


def _two_digits(value: float) -> str:
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"
