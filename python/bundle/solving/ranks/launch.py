"""Number and rank of the processes that mpirun started, without mpi4py."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bundle.solving.ranks.crew import Crew

# Variables of Open MPI, and of MPICH with its derivatives.
_SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE")
_RANKS = ("OMPI_COMM_WORLD_RANK", "PMI_RANK")
_LOCAL_SIZES = ("OMPI_COMM_WORLD_LOCAL_SIZE", "MPI_LOCALNRANKS")

_crew: Crew | None = None


def size_by_launcher() -> int:
    """Return the number of processes; 1 without a launcher."""
    return _number(_SIZES, 1)


def rank_by_launcher() -> int:
    """Return the rank of this process, from 0 on."""
    return _number(_RANKS, 0)


def threads_of_one_process(cores: int) -> int:
    """Return the default number of threads of a process.

    These are the cores that the launcher bound it to. Without binding, the processes of this
    machine share all cores.
    """
    if size_by_launcher() == 1:
        return cores
    bound = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else cores
    if bound < (os.cpu_count() or bound):
        return min(bound, cores)
    return max(1, cores // _number(_LOCAL_SIZES, size_by_launcher()))


def current() -> Crew | None:
    """Return the processes that share a solve; None: this process is the only one."""
    return _crew


@contextmanager
def use(crew: Crew) -> Iterator[None]:
    """Divide the solves within this context among these processes."""
    global _crew
    before, _crew = _crew, crew
    try:
        yield
    finally:
        _crew = before


def _number(names: tuple[str, ...], default: int) -> int:
    for name in names:
        value = os.environ.get(name, "")
        if value.isdigit():
            return int(value)
    return default
