"""Sums and broadcasts of the core by mpi4py."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

import bundle._core as _core

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
