"""Which methods a comparison runs: every combination of what was asked for, each once."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

from bundle import _core
from bundle.comparison.method import ITERATIVE, Method
from bundle.errors import InputError
from bundle.options import SolveOptions

__all__ = ["BACKENDS", "SOLVERS", "expand"]

BACKENDS = ("fused", "ceres")
SOLVERS = ("dense_schur", "sparse_schur", "iterative_schur")
"""What is compared unless something else is asked for."""


def expand(
    *,
    solvers: Iterable[str] = SOLVERS,
    preconditioners: Iterable[str] = ("auto",),
    orderings: Iterable[str] = ("points_first",),
    backends: Iterable[str] = BACKENDS,
    threads: Iterable[int] = (0,),
) -> tuple[Method, ...]:
    """Return the methods, backend by backend.

    Preconditioners apply to what iterates. Thread counts beyond the cores become the cores, as in
    a solve; 0 means all of them.

    Raises:
        InputError: a value is none of its option, or one of the lists is empty.
    """
    given: dict[str, tuple[Any, ...]] = {
        "backend": tuple(backends),
        "linear_solver_type": tuple(solvers),
        "linear_solver_ordering": tuple(orderings),
        "preconditioner_type": tuple(preconditioners),
        "num_threads": tuple(threads),
    }
    for name, values in given.items():
        if not values:
            raise InputError(f"{name}: expected at least one to compare, found none")
    combinations = itertools.product(*given.values())
    chosen = (SolveOptions(**dict(zip(given, values, strict=True))) for values in combinations)
    return tuple(dict.fromkeys(map(_method, chosen)))


def _method(options: SolveOptions) -> Method:
    iterates = options.linear_solver_type in ("auto", *ITERATIVE)
    cores = _core.hardware_threads()
    return Method(
        backend=options.backend,
        linear_solver_type=options.linear_solver_type,
        linear_solver_ordering=options.linear_solver_ordering,
        preconditioner_type=options.preconditioner_type if iterates else "auto",
        num_threads=min(options.num_threads or cores, cores),
    )
