"""Methods of a comparison: every combination of the requested values, each once."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

import bundle._core as _core
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, brief
from bundle.interface.option_fields import number
from bundle.interface.options import SolveOptions
from bundle.interface.planning_options import (
    BACKENDS,
    ORDERINGS,
    PRECONDITIONERS,
    SOLVERS,
    THREADS,
    TRUST_REGIONS,
)
from bundle.interface.pose_graph_options import PoseGraphOptions

_USUAL = "levenberg_marquardt"
ITERATIVE = ("iterative_schur", "cgnr")


@dataclass(frozen=True, kw_only=True)
class Method:
    """Options that a comparison varies, by the names and values of SolveOptions.

    ``num_threads`` is never 0. ``preconditioner_type`` is "auto" for direct solvers.
    """

    backend: str
    linear_solver_type: str
    linear_solver_ordering: str = "points_first"
    preconditioner_type: str = "auto"
    trust_region_strategy_type: str = _USUAL
    num_threads: int

    @property
    def name(self) -> str:
        """Return "fused SPARSE_SCHUR" with non-default values, without threads."""
        words = [self.backend, self.linear_solver_type.upper()]
        if self.preconditioner_type != "auto":
            words.append(self.preconditioner_type.upper())
        if self.linear_solver_ordering != "points_first":
            words.append(self.linear_solver_ordering.replace("_", " "))
        if self.trust_region_strategy_type != _USUAL:
            words.append(self.trust_region_strategy_type.replace("_", "-"))
        return " ".join(words)

    @property
    def threads(self) -> str:
        """Return text such as "2 threads"."""
        return plural(self.num_threads, "thread")

    @property
    def is_iterative(self) -> bool:
        """True if the linear solver is iterative for every problem."""
        return self.linear_solver_type in ITERATIVE

    def options(self, base: SolveOptions) -> SolveOptions:
        """Return the options of a solve by this method."""
        return base.replace(
            backend=self.backend,
            linear_solver_type=self.linear_solver_type,
            linear_solver_ordering=self.linear_solver_ordering,
            preconditioner_type=self.preconditioner_type,
            trust_region_strategy_type=self.trust_region_strategy_type,
            num_threads=self.num_threads,
        )


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


def expand(
    *,
    solvers: Iterable[str] = SOLVERS,
    preconditioners: Iterable[str] = PRECONDITIONERS,
    orderings: Iterable[str] = ORDERINGS,
    backends: Iterable[str] = BACKENDS,
    trust_regions: Iterable[str] = TRUST_REGIONS,
    threads: Iterable[int] = THREADS,
) -> tuple[Method, ...]:
    """Return the methods, backend by backend.

    Values without effect, such as the preconditioner of a direct solver, are dropped, and so are
    doglegs of iterative solvers if Levenberg-Marquardt is compared, too: they need exact steps.
    Thread counts are limited to the number of cores, as in a solve; 0 stands for all cores.
    """
    given: dict[str, tuple[Any, ...]] = {
        "backend": as_tuple("backends", backends),
        "linear_solver_type": as_tuple("solvers", solvers),
        "linear_solver_ordering": as_tuple("orderings", orderings),
        "preconditioner_type": as_tuple("preconditioners", preconditioners),
        "trust_region_strategy_type": as_tuple("trust_regions", trust_regions),
        "num_threads": thread_counts("num_threads", as_tuple("threads", threads)),
    }
    for name, values in given.items():
        if not values:
            raise InputError(f"{name}: expected at least one value to compare, found 0")
    combinations = itertools.product(*given.values())
    chosen = (SolveOptions(**dict(zip(given, values, strict=True))) for values in combinations)
    methods = dict.fromkeys(map(_method, chosen))
    usual = {method for method in methods if method.trust_region_strategy_type == _USUAL}
    return tuple(m for m in methods if m in usual or not (usual and m.is_iterative))


def as_tuple(argument: str, values: Any) -> tuple[Any, ...]:
    """Return the values of a list; a single word becomes a list with one value."""
    if isinstance(values, str):
        return (values,)
    try:
        return tuple(values)
    except TypeError:
        raise InputError(f"{argument}: expected a list, found {brief(values)}") from None


def thread_counts(argument: str, values: Iterable[Any]) -> tuple[int, ...]:
    """Return the distinct effective thread counts: at most the number of cores; 0 becomes all."""
    cores = _core.hardware_threads()
    checked = [number(argument, count, whole=True, minimum=0) for count in values]
    return tuple(dict.fromkeys(min(count or cores, cores) for count in checked))


def _method(options: SolveOptions) -> Method:
    options = options.without_idle()
    return Method(
        backend=options.backend,
        linear_solver_type=options.linear_solver_type,
        linear_solver_ordering=options.linear_solver_ordering,
        preconditioner_type=options.preconditioner_type,
        trust_region_strategy_type=options.trust_region_strategy_type,
        num_threads=options.num_threads,
    )
