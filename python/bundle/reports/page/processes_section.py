"""Predicted cost of several processes, on the page of a problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bundle.figures.drawing import Figure
from bundle.figures.marks import Line, logarithmic
from bundle.planning.inspection.rank_prediction import RankPrediction
from bundle.reports.sections import Section
from bundle.reports.terminal.inspect import rank_sections


def processes_section(
    predictions: Sequence[RankPrediction], network: tuple[float, float]
) -> list[Section]:
    """Return a table, and charts of step time and memory against the number of processes.

    Args:
        predictions: predictions of ``predict_ranks``; without any, nothing is drawn.
        network: gigabits per second, and latency in microseconds.
    """
    rows = sorted(predictions, key=lambda row: row.num_processes)
    figures = [_time(rows), _memory(rows)] if len(rows) > 1 else []
    return [replace(section, figures=figures) for section in rank_sections(rows, network)]


def _time(rows: Sequence[RankPrediction]) -> Figure:
    counts = [float(row.num_processes) for row in rows]
    parts = {
        "a step": [row.time_per_step_in_seconds for row in rows],
        "points, divided": [row.points_time_per_step_in_seconds for row in rows],
        "the first process alone": [row.first_time_per_step_in_seconds for row in rows],
        "messages": [row.network_time_per_step_in_seconds or float("nan") for row in rows],
        "a step of one process / N": [
            row.efficiency * row.time_per_step_in_seconds for row in rows
        ],
    }
    return _figure("Time of a step, on a log scale", parts, counts, "seconds")


def _memory(rows: Sequence[RankPrediction]) -> Figure:
    counts = [float(row.num_processes) for row in rows]
    parts = {
        "the first process": [row.memory_of_first_in_bytes / 1e9 for row in rows],
        "each of the others": [
            row.memory_of_others_in_bytes / 1e9 if row.num_processes > 1 else float("nan")
            for row in rows
        ],
    }
    return _figure("Peak memory, on a log scale", parts, counts, "GB")


def _figure(title: str, parts: dict[str, list[float]], counts: list[float], unit: str) -> Figure:
    x = np.array(counts)
    lines = tuple(
        Line(name, x, np.array(values), colour=k, dash=k)
        for k, (name, values) in enumerate(parts.items())
    )
    heights = [value for values in parts.values() for value in values]
    return Figure(
        name="processes", title=title, marks=lines, x=logarithmic(counts, "processes"),
        y=logarithmic(heights, unit),
    )  # fmt: skip
