"""Processes of a divided solve, and their messages."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.interface.summary import ProcessPart
from bundle.solving.constraints.restrictions import Restrictions
from bundle.solving.ranks.partition import ProblemPart


class Ranks(Protocol):
    """Communication of one rank in ``_core.solve_part``, with counts of its messages."""

    rank: int
    num_ranks: int
    traffic: dict[str, list[float]]


class Meeting:
    """Communication of all processes, which make the same calls in the same order; here of one."""

    rank = 0
    num_ranks = 1

    def broadcast(self, value: Any = None) -> Any:
        """Return the value of rank 0."""
        return value

    def gather(self, value: Any) -> list[Any]:
        """Return the values of all ranks to rank 0, None to the other ranks."""
        return [value]

    def ranks(self) -> Ranks:
        """Return the communication of this rank in one solve."""
        raise NotImplementedError


class Crew(Protocol):
    """Interface of rank 0 to the other processes."""

    num_ranks: int  # number of processes
    is_solving: bool  # True while the other ranks solve; they accept no other job until the end
    is_told_to_end: bool  # True after Ctrl-C; checked after each iteration

    def ranks(self) -> Ranks:
        """Return the communication of rank 0 in one solve."""

    def send(self, job: Job, rank: int) -> None:
        """Send a job to another rank."""

    def receive(self, rank: int) -> PartOfOutput:
        """Return the output of another rank."""


@dataclass
class Job:
    """Input of one process."""

    part: ProblemPart  # the points of the process
    options: dict[str, Any]  # resolved options
    # bounds, and the constant and tied parameters; None without any
    restrictions: Restrictions | None
    factors: Any  # factors in the form of ``partition.factors_of``
    # (num_images,) True if the full problem has observations in the image
    image_is_observed: NDArray[np.uint8]


@dataclass
class PartOfOutput:
    """Output of one process: its points, the costs of its factors, and its record."""

    points: NDArray[np.float64]
    factor_costs_before: NDArray[np.float64]
    factor_costs_after: NDArray[np.float64]
    process: ProcessPart
