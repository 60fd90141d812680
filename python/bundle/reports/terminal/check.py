"""What `bundle check` says."""

from __future__ import annotations

import dataclasses
from typing import Any

from rich.console import RenderableType

from bundle.base.tables import facts, format_name
from bundle.base.words import contents
from bundle.checking.gradient_report import GradientReport, explanation
from bundle.errors import shown
from bundle.model.problem import Problem
from bundle.reports.terminal import json

__all__ = ["as_json", "checked"]


def checked(path: str, problem: Problem, report: GradientReport) -> list[RenderableType]:
    """Return the report on a problem's own Jacobians."""
    return [
        facts(
            [("input", f"{shown(path)} ({format_name(problem.format)})"), ("", contents(problem))]
        ),
        *explanation(report),
    ]


def as_json(
    path: str,
    problem: Problem,
    report: GradientReport,
    options: dict[str, Any],
    wall_time: float,
) -> dict[str, Any]:
    """Return the report of `bundle check` for programs; wall_time in seconds."""
    numbers = dataclasses.asdict(report)
    numbers["histogram"] = [
        {"low": low, "high": high, "count": count} for low, high, count in report.histogram
    ]
    return {
        **json.heading("check", path, problem),
        "options": options,
        **json.plain(numbers),
        "wall_time": {"total": wall_time},
    }
