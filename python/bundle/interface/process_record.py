"""Record of the processes of a distributed solve: balance, times, messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

__all__ = ["ProcessPart", "ProcessRecord", "Traffic"]


@dataclass(frozen=True, kw_only=True)
class ProcessPart:
    """One process: what it had of the problem and how long its phases took, in seconds.

    The phases are those of :class:`bundle.Summary`; each includes the time in which the process
    waited for the others, ``waiting_time_in_seconds`` in all.
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
        num_messages: calls in each process.
        num_bytes: of the arrays that were summed or sent, once for each call.
        seconds: in these calls, of the first process; waiting for others is part of it.
    """

    what: str
    num_messages: int
    num_bytes: int
    seconds: float


@dataclass(frozen=True, kw_only=True)
class ProcessRecord:
    """A solve by several processes.

    Attributes:
        parts: one for each process, the first first.
        traffic: the kinds of messages, in the order of their first appearance.
    """

    parts: tuple[ProcessPart, ...]
    traffic: tuple[Traffic, ...]

    @staticmethod
    def of_dict(given: Mapping[str, Any]) -> ProcessRecord:
        """Return what ``dataclasses.asdict``, and JSON, made of a record."""
        return ProcessRecord(
            parts=tuple(ProcessPart(**part) for part in given["parts"]),
            traffic=tuple(Traffic(**kind) for kind in given["traffic"]),
        )

    @property
    def balance(self) -> float:
        """Observations of the fullest process over the mean; 1 where all have as many."""
        counts = [part.num_observations for part in self.parts]
        return max(counts) * len(counts) / max(sum(counts), 1)

    @property
    def num_bytes(self) -> int:
        """Total of all messages."""
        return sum(kind.num_bytes for kind in self.traffic)
