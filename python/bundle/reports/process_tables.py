"""What the report of a divided solve says of its processes."""

from __future__ import annotations

from rich.console import RenderableType

from bundle.memory_sizes import format_size
from bundle.process_record import ProcessPart, ProcessRecord
from bundle.tables import columns, facts, seconds

__all__ = ["process_tables"]

_PHASES = (
    ("preprocessor", "preprocessor_time_in_seconds"),
    ("Jacobians, elimination", "jacobian_evaluation_time_in_seconds"),
    ("reduced linear solver", "linear_solver_time_in_seconds"),
    ("back-substitution, residuals", "residual_evaluation_time_in_seconds"),
    ("messages and waiting", "waiting_time_in_seconds"),
    ("total", "total_time_in_seconds"),
)


def process_tables(record: ProcessRecord | None) -> list[RenderableType]:
    """Return balance, times and messages of several processes; nothing where there was one."""
    if record is None:
        return []
    parts = record.parts
    observations = [part.num_observations for part in parts]
    memory = [part.peak_memory_in_bytes for part in parts]
    balance = (
        f"{min(observations)} to {max(observations)} observations each, "
        f"the most {100 * (record.balance - 1):.2g} % above the mean"
    )
    times = [(name, *_slowest(parts, field)) for name, field in _PHASES]
    messages = [
        (kind.what, str(kind.num_messages), format_size(kind.num_bytes), seconds(kind.seconds))
        for kind in record.traffic
    ]
    return [
        facts(
            [
                ("processes", f"{len(parts)}, {balance}"),
                ("", f"peak memory {format_size(min(memory))} to {format_size(max(memory))}"),
            ]
        ),
        "",
        columns(("time of the processes", "slowest", "process", "mean"), times),
        "",
        columns(("messages", "number", "size", "seconds"), messages),
        "",
    ]


def _slowest(parts: tuple[ProcessPart, ...], field: str) -> tuple[str, str, str]:
    times = [getattr(part, field) for part in parts]
    slowest = max(times)
    return seconds(slowest), str(times.index(slowest)), seconds(sum(times) / len(times))
