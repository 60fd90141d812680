"""Sums over processes, by threads that send each other arrays as MPI does."""

import queue
import threading

import numpy as np
import pytest

from bundle import _core
from bundle.solving.ranks import mpi_crew
from bundle.solving.ranks.mpi_crew import MpiRanks


class ThreadComm:
    """Send and Recv of one rank; `boxes` holds what is under way, by (from, to)."""

    def __init__(self, rank, size, boxes):
        self.rank, self.size, self._boxes = rank, size, boxes

    def Send(self, array, to):  # noqa: N802
        self._boxes[self.rank, to].put(np.array(array))

    def Recv(self, array, source):  # noqa: N802
        array[:] = self._boxes[source, self.rank].get(timeout=10)


def summed(num_ranks, values, errors):
    """Return what rank 0 has after a sum over threads, and the tallies of all."""
    pairs = [(a, b) for a in range(num_ranks) for b in range(num_ranks)]
    boxes = {pair: queue.Queue() for pair in pairs}
    ranks = [MpiRanks(ThreadComm(rank, num_ranks, boxes)) for rank in range(num_ranks)]
    mine = [(values[rank].copy(), errors[rank].copy()) for rank in range(num_ranks)]

    def work(rank):
        ranks[rank].sum_double_doubles_to_first("sums", *map(memoryview, mine[rank]))

    threads = [threading.Thread(target=work, args=(rank,)) for rank in range(num_ranks)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    assert all(box.empty() for box in boxes.values())
    return mine[0], [rank.traffic["sums"] for rank in ranks]


@pytest.mark.parametrize("num_ranks", range(1, 9))
def test_double_doubles_are_those_of_pairs_of_neighbours(num_ranks, monkeypatch):
    """In messages of three numbers; every rank's values arrive, in one order for any timing."""
    monkeypatch.setattr(mpi_crew, "MOST_AT_ONCE", 3)
    rng = np.random.default_rng(num_ranks)
    values = rng.normal(size=(num_ranks, 7)) * 10.0 ** rng.integers(-8, 8, (num_ranks, 7))
    errors = values * 1e-17
    (sums, left), tallies = summed(num_ranks, values, errors)
    exact = [float(sum(map(np.longdouble, column))) for column in values.T]
    np.testing.assert_allclose(sums + left, exact, rtol=1e-15)
    level = [(values[rank].copy(), errors[rank].copy()) for rank in range(num_ranks)]
    while len(level) > 1:  # neighbours first
        for first, second in zip(level[::2], level[1::2], strict=False):
            _core.add_double_doubles(*second, *first)
        level = level[::2]
    np.testing.assert_array_equal(sums, level[0][0])
    np.testing.assert_array_equal(left, level[0][1])
    assert all(tally[:2] == [1, 2 * 7 * 8] for tally in tallies)
