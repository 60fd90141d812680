"""Processes of a divided solve as threads of one: the same core, without MPI."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

import bundle
from bundle import InputError, _core
from bundle.solving.ranks.crew import Job, PartOfOutput
from bundle.solving.ranks.divided_solve import work_on
from bundle.solving.ranks.launch import use


class ThreadRanks:
    """Meets the others at a barrier; rank 0 sums, in the order of the ranks."""

    def __init__(self, crew: ThreadCrew, rank: int) -> None:
        self._crew = crew
        self.rank = rank
        self.num_ranks = crew.num_ranks
        self.traffic: dict[str, list[float]] = {}

    def sum_to_first(self, what: str, values: memoryview) -> None:
        given = self._meet(what, values)
        if self.rank == 0:
            np.frombuffer(values)[:] = sum(given[1:], given[0].copy())
        self._crew.barrier.wait()

    def sum_double_doubles_to_first(self, what: str, sums: memoryview, errors: memoryview) -> None:
        both = np.concatenate([np.frombuffer(sums), np.frombuffer(errors)])
        given = self._meet(what, memoryview(both))
        if self.rank == 0:
            mine = np.frombuffer(sums), np.frombuffer(errors)
            for other in given[1:]:
                _core.add_double_doubles(*np.split(other, 2), *mine)
        self._crew.barrier.wait()

    def broadcast(self, what: str, values: memoryview, root: int) -> None:
        given = self._meet(what, values)
        if self.rank != root:
            np.frombuffer(values)[:] = given[root]
        self._crew.barrier.wait()

    def _meet(self, what: str, values: memoryview) -> list[Any]:
        array = np.frombuffer(values)
        self._crew.given[self.rank] = (what, array)
        self._crew.barrier.wait()
        names = {name for name, _ in self._crew.given}
        assert names == {what}, f"ranks meet for different things: {names}"
        tally = self.traffic.setdefault(what, [0, 0, 0.0])
        tally[0] += 1
        tally[1] += array.nbytes
        return [of for _, of in self._crew.given]


class ThreadCrew:
    def __init__(self, num_ranks: int) -> None:
        self.num_ranks = num_ranks
        self.is_solving = False
        self.is_told_to_end = False
        self.barrier = threading.Barrier(num_ranks, timeout=30)
        self.given: list[Any] = [None] * num_ranks
        self.made: dict[int, PartOfOutput | BaseException] = {}
        self.threads: dict[int, threading.Thread] = {}

    def ranks(self) -> ThreadRanks:
        return ThreadRanks(self, 0)

    def send(self, job: Job, rank: int) -> None:
        self.threads[rank] = threading.Thread(target=self._work, args=(job, rank), daemon=True)
        self.threads[rank].start()

    def receive(self, rank: int) -> PartOfOutput:
        self.threads[rank].join()
        made = self.made[rank]
        if isinstance(made, BaseException):
            raise made
        return made

    def meeting(self, rank: int = 0) -> ThreadMeeting:
        return ThreadMeeting(self, rank)

    def send_to_all(self, job: Any) -> None:
        self.is_solving = True
        for rank in range(1, self.num_ranks):
            self.threads[rank] = threading.Thread(
                target=self._work_on, args=(job, rank), daemon=True
            )
            self.threads[rank].start()

    def _work_on(self, job: Any, rank: int) -> None:
        with suppress(threading.BrokenBarrierError):  # where the first has failed
            job.work(self.meeting(rank))

    def release(self) -> None:
        self.is_solving = False

    def _work(self, job: Job, rank: int) -> None:
        try:
            self.made[rank] = work_on(job, ThreadRanks(self, rank))[1]
        except BaseException as error:
            self.made[rank] = error
            if not isinstance(error, InputError):  # which all of them find alike
                self.barrier.abort()


class ThreadMeeting:
    """All processes; see ``ranks.crew.Meeting``."""

    def __init__(self, crew: ThreadCrew, rank: int) -> None:
        self._crew = crew
        self.rank = rank
        self.num_ranks = crew.num_ranks

    def broadcast(self, value: Any = None) -> Any:
        return self._exchange(value)[0]

    def gather(self, value: Any) -> Any:
        given = self._exchange(value)
        return given if self.rank == 0 else None

    def ranks(self) -> ThreadRanks:
        return ThreadRanks(self._crew, self.rank)

    def _exchange(self, value: Any) -> list[Any]:
        self._crew.given[self.rank] = value
        self._crew.barrier.wait()
        given = list(self._crew.given)
        self._crew.barrier.wait()
        return given


@contextmanager
def processes(num_ranks: int) -> Iterator[ThreadCrew]:
    """Divide the solves within the context among threads."""
    crew = ThreadCrew(num_ranks)
    with use(crew):
        yield crew


def alone_and_divided(problem: Any, num_ranks: int, **options: Any) -> tuple[Any, Any]:
    """Solve by one process with two threads, and by several with one each."""
    alone = bundle.solve(problem, num_threads=2, **options)
    with processes(num_ranks):
        divided = bundle.solve(problem, num_threads=1, **options)
    return alone, divided
