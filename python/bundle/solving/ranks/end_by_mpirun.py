"""Error output of a run that mpirun ends: one line; ``bind_launcher.cpp`` has the protocol.

Processes on machines other than mpirun's print nothing.
"""

from __future__ import annotations

import os
import signal
from pathlib import Path

import bundle._core as _core
from bundle.solving.ranks.launch import rank_by_launcher

PARENTS = ("mpirun", "prterun")
"""Names of the process that is the parent on mpirun's machine."""


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
