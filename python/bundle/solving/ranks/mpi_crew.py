"""Processes of mpirun: the interface of rank 0, the loop of the other ranks, their sums.

The other ranks poll for jobs a hundred times per second, so that they take no CPU time from rank 0
while it reads or writes. A process that fails ends all processes, because the other ranks wait for
its contribution to a sum.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.solving.ranks.crew import Job, Meeting, PartOfOutput, Ranks
from bundle.solving.ranks.divided_solve import work_on

BETWEEN_LOOKS = 0.01
DELIVERY = 0.5  # seconds that mpirun has to forward a line before it ends all ranks
GRACE = 3.0
"""Seconds in which rank 0 may end all ranks with its own line, which is often the same line."""


class MpiCrew:
    """The first process of several; see ``divided_solve.Crew``.

    ``comm``: mpi4py's communicator of all processes.
    """

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self.num_ranks: int = comm.size
        self.is_solving = False
        self.is_told_to_end = False

    def interrupt(self, *_signal: object) -> None:
        """End the solve with the best state after an iteration, or raise KeyboardInterrupt.

        An exception within a sum would leave the other ranks waiting.
        """
        if not self.is_solving:
            raise KeyboardInterrupt
        self.is_told_to_end = True

    def meeting(self) -> MpiMeeting:
        """Return the communication of all ranks outside a solve."""
        return MpiMeeting(self._comm)

    def send_to_all(self, job: Any) -> None:
        """Send a job with a method ``work``; the other ranks accept no other job until it ends."""
        self.is_solving = True
        for rank in range(1, self.num_ranks):
            _any_size(self._comm).send(job, rank)

    def release(self) -> None:
        """Record that the other ranks wait for a job again."""
        self.is_solving = False

    def ranks(self) -> Ranks:
        """Return the communication of this rank in one solve."""
        return MpiRanks(self._comm)

    def send(self, job: Job, rank: int) -> None:
        """Send a job, of any size."""
        _any_size(self._comm).send(job, rank)

    def receive(self, rank: int) -> PartOfOutput:
        """Return the output of another rank."""
        part: PartOfOutput = _any_size(self._comm).recv(source=rank)
        return part

    def end(self, code: int) -> None:
        """End the other ranks. Kill them if they are in a solve that this rank has left."""
        if self.is_solving:
            time.sleep(DELIVERY)
            self._comm.Abort(code)
        for rank in range(1, self.num_ranks):
            _any_size(self._comm).send(None, rank)


class MpiMeeting(Meeting):
    """All processes."""

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self.rank: int = comm.rank
        self.num_ranks: int = comm.size

    def broadcast(self, value: Any = None) -> Any:
        """Return the value of rank 0."""
        return _any_size(self._comm).bcast(value, root=0)

    def gather(self, value: Any) -> Any:
        """Return the values of all ranks to rank 0, None to the other ranks."""
        return _any_size(self._comm).gather(value, root=0)

    def ranks(self) -> Ranks:
        """Return the communication of this rank in one solve."""
        return MpiRanks(self._comm)


def serve(comm: Any, complain: Callable[[str], None], describe: Callable[[Exception], str]) -> None:
    """Run the jobs of rank 0 until it sends None.

    ``comm``: mpi4py's communicator of all processes. ``describe``: function that returns the
    one-line error message of an exception.
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


MOST_AT_ONCE = 1 << 24
"""Largest number of doubles per message: counts of MPI have 31 bits, and Open MPI's buffers take
memory."""


class MpiRanks:
    """Communication that ``_core.solve_part`` calls, with counts {what: [messages, bytes, s]}.

    MPI_Reduce computes the sums. Open MPI chooses the order of summation by the number of processes
    and the length of the message, not by the order of arrival. MPI has no double-double sums: this
    class computes them along a binary tree.
    """

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self.rank: int = comm.rank
        self.num_ranks: int = comm.size
        self.traffic: dict[str, list[float]] = {}

    def sum_to_first(self, what: str, values: memoryview) -> None:
        """Replace the values of rank 0 by the sums over all ranks."""
        from mpi4py import MPI

        def reduce(piece: Any) -> None:
            if self.rank == 0:
                self._comm.Reduce(MPI.IN_PLACE, piece, op=MPI.SUM, root=0)
            else:
                self._comm.Reduce(piece, None, op=MPI.SUM, root=0)

        self._for_pieces(what, values, reduce)

    def sum_double_doubles_to_first(self, what: str, sums: memoryview, errors: memoryview) -> None:
        """Replace the values of rank 0 by the double-double sums over all ranks."""
        begun = perf_counter()
        mine = np.frombuffer(sums, np.float64), np.frombuffer(errors, np.float64)
        for begin in range(0, len(mine[0]), MOST_AT_ONCE):
            self._sum_piece(*(array[begin : begin + MOST_AT_ONCE] for array in mine))
        self._count(what, mine[0].nbytes + mine[1].nbytes, begun)

    def _sum_piece(self, sums: Any, errors: Any) -> None:
        step = 1
        while step < self.num_ranks and self.rank % (2 * step) == 0:
            if self.rank + step < self.num_ranks:
                given = np.empty_like(sums), np.empty_like(errors)
                for array in given:
                    self._comm.Recv(array, self.rank + step)
                _core.add_double_doubles(*given, sums, errors)
            step *= 2
        if self.rank > 0:
            for array in (sums, errors):
                self._comm.Send(array, self.rank - step)

    def broadcast(self, what: str, values: memoryview, root: int) -> None:
        """Replace the values on all ranks by the values of rank ``root``."""
        self._for_pieces(what, values, lambda piece: self._comm.Bcast(piece, root=root))

    def _for_pieces(self, what: str, values: memoryview, send: Callable[[Any], None]) -> None:
        begun = perf_counter()
        array = np.frombuffer(values, np.float64)
        for begin in range(0, len(array), MOST_AT_ONCE):
            send(array[begin : begin + MOST_AT_ONCE])
        self._count(what, array.nbytes, begun)

    def _count(self, what: str, num_bytes: int, begun: float) -> None:
        tally = self.traffic.setdefault(what, [0, 0, 0.0])
        tally[0] += 1
        tally[1] += num_bytes
        tally[2] += perf_counter() - begun
