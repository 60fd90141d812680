"""Which methods a comparison runs: every combination of what was asked for, each once."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import Any

from bundle import _core
from bundle.errors import InputError, brief
from bundle.interface.compare_defaults import BACKENDS, ORDERINGS, PRECONDITIONERS, SOLVERS, THREADS
from bundle.interface.option_fields import number
from bundle.interface.options import SolveOptions
from bundle.planning.comparison.method import Method

__all__ = ["expand"]


def expand(
    *,
    solvers: Iterable[str] = SOLVERS,
    preconditioners: Iterable[str] = PRECONDITIONERS,
    orderings: Iterable[str] = ORDERINGS,
    backends: Iterable[str] = BACKENDS,
    threads: Iterable[int] = THREADS,
) -> tuple[Method, ...]:
    """Return the methods, backend by backend.

    What has no effect on a method, such as the preconditioner of a direct solver, is dropped.
    Thread counts beyond the cores become the cores, as in a solve; 0 means all of them.

    Raises:
        InputError: a value is none of its option, or one of the lists is empty.
    """
    given: dict[str, tuple[Any, ...]] = {
        "backend": _listed("backends", backends),
        "linear_solver_type": _listed("solvers", solvers),
        "linear_solver_ordering": _listed("orderings", orderings),
        "preconditioner_type": _listed("preconditioners", preconditioners),
        "num_threads": _capped(_listed("threads", threads)),
    }
    for name, values in given.items():
        if not values:
            raise InputError(f"{name}: expected at least one to compare, found none")
    combinations = itertools.product(*given.values())
    chosen = (SolveOptions(**dict(zip(given, values, strict=True))) for values in combinations)
    return tuple(dict.fromkeys(map(_method, chosen)))


def _listed(argument: str, values: Any) -> tuple[Any, ...]:
    """Return the values of a list; a single word is a list of one."""
    if isinstance(values, str):
        return (values,)
    try:
        return tuple(values)
    except TypeError:
        raise InputError(f"{argument}: expected a list, found {brief(values)}") from None


def _capped(threads: tuple[Any, ...]) -> tuple[int, ...]:
    """Return thread counts as a solve takes them, each once: at most the cores, 0 for all."""
    cores = _core.hardware_threads()
    checked = (number("num_threads", count, whole=True, minimum=0) for count in threads)
    return tuple(dict.fromkeys(min(count or cores, cores) for count in checked))


def _method(options: SolveOptions) -> Method:
    options = options.without_idle()
    return Method(
        backend=options.backend,
        linear_solver_type=options.linear_solver_type,
        linear_solver_ordering=options.linear_solver_ordering,
        preconditioner_type=options.preconditioner_type,
        num_threads=options.num_threads,
    )
