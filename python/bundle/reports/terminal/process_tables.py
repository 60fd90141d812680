"""Processes in the report of a distributed solve: balance, times, messages."""

from __future__ import annotations

from bundle.base.words import format_size, seconds
from bundle.interface.summary import ProcessPart, ProcessRecord
from bundle.reports.sections import Column, Section, Table

_PHASES = (
    ("preprocessor", "preprocessor_time_in_seconds"),
    ("Jacobians, elimination", "jacobian_evaluation_time_in_seconds"),
    ("reduced linear solver", "linear_solver_time_in_seconds"),
    ("back-substitution, residuals", "residual_evaluation_time_in_seconds"),
    ("messages and waiting", "waiting_time_in_seconds"),
    ("total", "total_time_in_seconds"),
)


MESSAGES = (
    Column("messages", "what"),
    Column("number", "num_messages"),
    Column("size", "num_bytes", format_size),
    Column("seconds", "seconds", seconds),
)


def process_sections(record: ProcessRecord) -> list[Section]:
    """Return balance, times and messages of several processes."""
    parts = record.parts
    observations = [part.num_observations for part in parts]
    memory = [part.peak_memory_in_bytes for part in parts]
    balance = (
        f"{min(observations)} to {max(observations)} observations each, "
        f"the most {100 * (record.balance - 1):.2g} % above the mean"
    )
    times = [(name, *_slowest(parts, field)) for name, field in _PHASES]
    facts = [
        ("processes", f"{len(parts)}, {balance}"),
        ("", f"peak memory {format_size(min(memory))} to {format_size(max(memory))}"),
    ]
    head = ("time of the processes", "slowest", "process", "mean")
    return [
        Section(facts=facts),
        Section(tables=[Table.of(head, times)]),
        Section(tables=[Table(MESSAGES, record.traffic)]),
    ]


def _slowest(parts: tuple[ProcessPart, ...], field: str) -> tuple[str, str, str]:
    times = [getattr(part, field) for part in parts]
    slowest = max(times)
    return seconds(slowest), str(times.index(slowest)), seconds(sum(times) / len(times))
