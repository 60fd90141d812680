"""What the report of a divided solve says of its processes."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import RenderableType

from bundle.base.memory_sizes import format_size
from bundle.base.tables import columns, facts, notes, seconds
from bundle.base.words import duration
from bundle.interface.process_record import ProcessPart, ProcessRecord
from bundle.planning.inspection.rank_prediction import RankPrediction, find_rank_limit

__all__ = ["predicted_ranks", "process_tables"]

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


def predicted_ranks(
    ranks: Sequence[RankPrediction], network: tuple[float, float]
) -> list[RenderableType]:
    """Return what several processes would cost; nothing where none were asked for."""
    if not ranks:
        return []
    rows = [
        (
            str(row.num_processes),
            duration(row.time_per_step_in_seconds),
            duration(row.network_time_per_step_in_seconds) if row.bytes_per_step else "-",
            f"{100 * row.efficiency:.0f} %",
            format_size(row.bytes_per_step) if row.bytes_per_step else "-",
            format_size(row.memory_of_first_in_bytes),
            format_size(row.memory_of_others_in_bytes) if row.bytes_per_step else "-",
        )
        for row in ranks
    ]
    head = ("processes", "per step", "messages", "efficiency", "sent", "first: memory", "others")
    rate, latency = network
    limit = find_rank_limit(ranks)
    return [
        "",
        columns(head, rows),
        *notes(
            [
                *([] if limit is None else [limit.message]),
                f"Processes of mpirun, {ranks[0].method}, {rate:g} Gbit/s and {latency:g} "
                "microseconds between them; the first one solves the reduced system alone. Memory "
                "is that of whole processes, which read slices of BAL files and binary models.",
            ]
        ),
    ]


def _slowest(parts: tuple[ProcessPart, ...], field: str) -> tuple[str, str, str]:
    times = [getattr(part, field) for part in parts]
    slowest = max(times)
    return seconds(slowest), str(times.index(slowest)), seconds(sum(times) / len(times))
