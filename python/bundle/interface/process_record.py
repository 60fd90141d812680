"""Record of the processes of a distributed solve: balance, times, messages."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bundle.base.records import dataclass


@dataclass(frozen=True, kw_only=True)
class ProcessPart:
    """One process: its part of the problem, and the times of its phases in seconds.

    The phases are those of :class:`bundle.Summary`. Each includes the time in which the process
    waited for other processes; ``waiting_time_in_seconds`` is the total of these waiting times.
    """

    num_points: int
    num_observations: int
    preprocessor_time_in_seconds: float
    residual_evaluation_time_in_seconds: float
    jacobian_evaluation_time_in_seconds: float
    linear_solver_time_in_seconds: float
    total_time_in_seconds: float
    waiting_time_in_seconds: float
    peak_memory_in_bytes: int


@dataclass(frozen=True, kw_only=True)
class Traffic:
    """Messages of one kind between the processes of a solve.

    Attributes:
        what: "normal equations" (S, its right-hand side and block diagonal, to the first process),
            "gradient", "step", "scalars", or "setup".
        num_messages: number of calls in each process.
        num_bytes: size of the arrays that were summed or sent, counted once per call.
        seconds: time that the first process spent in these calls, including waiting for others.
    """

    what: str
    num_messages: int
    num_bytes: int
    seconds: float


@dataclass(frozen=True, kw_only=True)
class ProcessRecord:
    """A solve by several processes.

    Attributes:
        parts: one entry per process, in order of rank.
        traffic: one entry per kind of message, in the order of first appearance.
    """

    parts: tuple[ProcessPart, ...]
    traffic: tuple[Traffic, ...]

    @staticmethod
    def of_dict(given: Mapping[str, Any]) -> ProcessRecord:
        """Return the record from its ``dataclasses.asdict`` or JSON form."""
        return ProcessRecord(
            parts=tuple(ProcessPart(**part) for part in given["parts"]),
            traffic=tuple(Traffic(**kind) for kind in given["traffic"]),
        )

    @property
    def balance(self) -> float:
        """Largest number of observations of a process, divided by the mean; 1: balanced."""
        counts = [part.num_observations for part in self.parts]
        return max(counts) * len(counts) / max(sum(counts), 1)

    @property
    def num_bytes(self) -> int:
        """Total number of bytes of all messages."""
        return sum(kind.num_bytes for kind in self.traffic)
