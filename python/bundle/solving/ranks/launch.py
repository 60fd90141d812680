"""Start and end of processes by mpirun, without mpi4py."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import bundle._core as _core

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


# Error output of a run that mpirun ends: one line; ``bind_launcher.cpp`` has the protocol.
#
# Processes on machines other than mpirun's print nothing.

PARENTS = ("mpirun", "prterun")  # names of the process that is the parent on mpirun's machine


def begin() -> None:
    """Prepare for signals of Open MPI's mpirun, if it started this process."""
    size = os.environ.get("OMPI_COMM_WORLD_SIZE", "1")
    if size == "1":
        return
    signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # mpirun passes it on; see many_processes
    _core.wait_for_the_end(_mark(), int(size) if size.isdigit() else 0)


def know_processes(pids: dict[int, int]) -> None:
    """Store the processes of this machine: {rank: process id}."""
    _core.know_processes(pids)


def take_the_word() -> bool:
    """Claim the right to print the final error. True for the first caller only."""
    return not _mark() or _core.take_the_word(_mark())


def speaks_for_all() -> bool:
    """Claim the right to print an error that all processes have."""
    if not _mark():
        return rank_by_launcher() == 0
    return take_the_word()


def _mark() -> str:
    """Return the path of the file whose creator prints; "" on machines other than mpirun's."""
    folder = os.environ.get("PMIX_SERVER_TMPDIR", "")
    try:
        with Path(f"/proc/{os.getppid()}/comm").open(encoding="utf-8") as file:
            is_there = file.read().strip() in PARENTS
    except OSError:
        return ""
    return f"{folder}/bundle_has_said_why" if folder and is_there else ""
