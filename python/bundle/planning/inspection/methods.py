"""Solver methods that an inspection compares."""

from __future__ import annotations

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.interface.options import PRECONDITIONER_TYPES

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
