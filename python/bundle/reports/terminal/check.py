"""Report of `bundle check`."""

from __future__ import annotations

from typing import Any

from bundle.checking.gradient_report import (
    GradientReport,
    measurements,
    mistakes,
    outcome,
    subject,
)
from bundle.model.problem import Problem
from bundle.reports.sections import Report, Section, fields
from bundle.reports.terminal.inputs import about_problem, problem_facts

__all__ = ["checked"]


def checked(
    path: str,
    problem: Problem,
    found: GradientReport,
    options: dict[str, Any],
    wall_time: float,
) -> Report:
    """Return the report on the Jacobians of a problem.

    Args:
        path: path of the input.
        problem: problem whose Jacobians were checked.
        found: result of the check.
        options: options of the check.
        wall_time: seconds.
    """
    histogram = [{"low": low, "high": high, "count": count} for low, high, count in found.histogram]
    return Report(
        command="check",
        input=about_problem(path, problem),
        headline=[outcome(found)],
        sections=[
            Section(text=mistakes(found)),
            Section(facts=problem_facts(path, problem), text=subject(found), is_detail=True),
            Section(text=measurements(found), is_joined=True, is_detail=found.verdict != "wrong"),
        ],
        data={
            "options": options,
            **(fields(found) | {"histogram": histogram}),
            "wall_time": {"total": wall_time},
        },
    )
