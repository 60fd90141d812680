"""Markdown tables: absolute numbers for bundle, ratios to them for everyone."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from typing import TypeVar

from benchmarks.measure import Spread
from benchmarks.rows import GAPS, Row

Runs = TypeVar("Runs")


def main(
    description: str | None,
    measured: Callable[[int, int, float], Runs],
    as_table: Callable[[Runs], str],
    *,
    repeat: int,
    timeout: float,
) -> None:
    """Measure as the command line says, and print the table.

    Args:
        description: docstring of the benchmark.
        measured: function of the number of repeats, of threads, and of the seconds of a run.
        as_table: function that formats the measured runs.
        repeat: default number of repeats.
        timeout: default of the longest time of a run, in seconds.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--repeat", type=int, default=repeat)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--timeout", type=float, default=timeout)
    options = parser.parse_args()
    print(as_table(measured(options.repeat, options.threads, options.timeout)))


def seconds(value: float) -> str:
    """Return a time in seconds with three digits; all times of a column have this unit."""
    return f"{value:.0f} s" if value >= 99.95 else f"{value:.3g} s"


def megabytes(value: float) -> str:
    """Return a size in MB."""
    return f"{value / 1e6:.0f} MB"


def ratio(
    spread: Spread | None,
    reference: Spread | None,
    unit: Callable[[float], str] = seconds,
    missing: str = "not reached",
) -> str:
    """Return the ratio of the medians, and in brackets that of the extremes to the same median.

    Without a reference it is the absolute median, in its unit.
    """
    if spread is None:
        return missing
    if reference is None or reference.median <= 0:
        return unit(spread.median)
    middle, low, high = (
        f"{value / reference.median:.2f}x" for value in (spread.median, spread.low, spread.high)
    )
    return middle if low == high else f"{middle} ({low}-{high})"


def absolute(spread: Spread | None, missing: str = "not reached") -> str:
    """Return the median in seconds, and in brackets the extremes if they print differently."""
    if spread is None:
        return missing
    middle, low, high = (seconds(value) for value in (spread.median, spread.low, spread.high))
    return middle if low == high else f"{middle} ({low}-{high})"


def grid(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table, all columns but the first aligned right."""
    marks = ["---"] + ["---:"] * (len(header) - 1)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (header, marks, *lines))


def _gap_header() -> list[str]:
    return [f"time to {gap:g}" for gap in GAPS]


def of_problem(rows: Sequence[Row]) -> str:
    """Return the table of one problem; the first row is the reference of all ratios."""
    reference = rows[0]
    lines = [_absolute(reference)] if not reference.failure else []
    lines += [_relative(row, reference) for row in rows]
    header = ["solver", "time per LM step", "steps", *_gap_header(), "total", "peak memory"]
    return grid([*header, "final gap", "cores"], lines)


def _absolute(row: Row) -> list[str]:
    times = [row.step, *row.reached, row.total]
    step, *reached = ["not reached" if time is None else seconds(time.median) for time in times]
    memory = megabytes(row.memory.median) if row.memory else ""
    return [f"**{row.solver}, absolute**", step, "", *reached, memory, "", ""]


def _relative(row: Row, reference: Row) -> list[str]:
    num_numbers = 6 + len(GAPS)
    if row.failure:
        return [row.solver, f"no result: {row.failure}", *[""] * (num_numbers - 1)]
    warnings = "".join(f"; **{text}**" for text in (row.remark, row.doubt) if text)
    name = f"{row.solver} ({row.used}){warnings}"
    reached = [ratio(*pair) for pair in zip(row.reached, reference.reached, strict=True)]
    return [
        name,
        ratio(row.step, reference.step, missing="no step"),
        str(row.num_steps),
        *reached,
        ratio(row.total, reference.total),
        ratio(row.memory, reference.memory, megabytes),
        f"{max(row.gap, 0.0):.0e}",
        f"{row.cores:.1f}",
    ]


def of_pair(pairs: Sequence[tuple[Row, Row]]) -> str:
    """Return one line a problem: how much longer or larger the second of each pair is."""
    lines = []
    for ours, theirs in pairs:
        if ours.failure or theirs.failure:
            reasons = [f"{r.solver}: {r.failure}" for r in (ours, theirs) if r.failure]
            lines.append(
                [ours.problem, "no result: " + "; ".join(reasons), *[""] * (3 + len(GAPS))]
            )
            continue
        step = seconds(ours.step.median) if ours.step else "no step"
        reached = [ratio(*pair) for pair in zip(theirs.reached, ours.reached, strict=True)]
        lines.append(
            [
                ours.problem,
                step,
                ratio(theirs.step, ours.step, missing="no step"),
                *reached,
                ratio(theirs.total, ours.total),
                ratio(theirs.memory, ours.memory, megabytes),
            ]
        )
    header = ["problem", "our time per LM step", "time per LM step", *_gap_header(), "total"]
    return grid([*header, "peak memory"], lines)
