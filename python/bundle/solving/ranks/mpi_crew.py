"""The processes of mpirun: the first one's view of the others, and what the others do.

The others wait for jobs and look for one a hundred times a second, so that they take no time from
the first one while it reads or writes. A process that fails ends all: it cannot be waited for, as
the others are in the middle of a sum.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from bundle.solving.ranks.divided_solve import Job, PartOfOutput, Ranks, work_on
from bundle.solving.ranks.mpi_ranks import MpiRanks

__all__ = ["MpiCrew", "serve"]

BETWEEN_LOOKS = 0.01
DELIVERY = 0.5
"""Seconds that mpirun has to pass on a line before it ends all."""
GRACE = 3.0
"""Seconds in which the first process may end all with its own line, which is often the same one."""


class MpiCrew:
    """The first process of several; see ``divided_solve.Crew``.

    Args:
        comm: mpi4py's, of all processes.
    """

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self.num_ranks: int = comm.size
        self.is_solving = False
        self.is_told_to_end = False

    def interrupt(self, *_signal: object) -> None:
        """End the solve after its iteration with the best state, or raise KeyboardInterrupt.

        An exception within a sum would leave the others waiting.
        """
        if not self.is_solving:
            raise KeyboardInterrupt
        self.is_told_to_end = True

    def meeting(self) -> MpiMeeting:
        """Return how all processes do more than a solve together."""
        return MpiMeeting(self._comm)

    def send_to_all(self, job: Any) -> None:
        """Send a job with a method ``work``; the others hear nothing else until its end."""
        self.is_solving = True
        for rank in range(1, self.num_ranks):
            _any_size(self._comm).send(job, rank)

    def release(self) -> None:
        """Take note that the others wait again."""
        self.is_solving = False

    def ranks(self) -> Ranks:
        """Return how this process meets the others in one solve."""
        return MpiRanks(self._comm)

    def send(self, job: Job, rank: int) -> None:
        """Send a job, of any size."""
        _any_size(self._comm).send(job, rank)

    def receive(self, rank: int) -> PartOfOutput:
        """Return what a process made of its job."""
        part: PartOfOutput = _any_size(self._comm).recv(source=rank)
        return part

    def end(self, code: int) -> None:
        """Let the others end; by force where they are in a solve that this process has left."""
        if self.is_solving:
            time.sleep(DELIVERY)
            self._comm.Abort(code)
        for rank in range(1, self.num_ranks):
            _any_size(self._comm).send(None, rank)


class MpiMeeting:
    """All processes; see ``slices.slice_reading.Meeting``."""

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self.rank: int = comm.rank
        self.num_ranks: int = comm.size

    def broadcast(self, value: Any = None) -> Any:
        """Return the value of the first."""
        return _any_size(self._comm).bcast(value, root=0)

    def gather(self, value: Any) -> Any:
        """Return the values of all to the first, None to the others."""
        return _any_size(self._comm).gather(value, root=0)

    def ranks(self) -> Ranks:
        """Return how the core meets the others in one solve."""
        return MpiRanks(self._comm)


def serve(comm: Any, complain: Callable[[str], None], describe: Callable[[Exception], str]) -> None:
    """Solve what the first process sends, until it sends nothing more.

    Args:
        comm: mpi4py's, of all processes.
        complain: prints a line.
        describe: what an exception says to a user, in one line.
    """
    while True:
        while not comm.iprobe(source=0):
            time.sleep(BETWEEN_LOOKS)
        job = _any_size(comm).recv(source=0)
        if job is None:
            return
        try:
            if not isinstance(job, Job):
                job.work(MpiMeeting(comm))
                continue
            _, part = work_on(job, MpiRanks(comm))
            _any_size(comm).send(part, 0)
        except Exception as error:
            time.sleep(GRACE)
            complain(f"error: process {comm.rank} of {comm.size}: {describe(error)}")
            time.sleep(DELIVERY)
            comm.Abort(2)


def _any_size(comm: Any) -> Any:
    """Return a communicator for objects, whose arrays may be larger than 2 GB."""
    from mpi4py.util import pkl5

    return pkl5.Intracomm(comm)
