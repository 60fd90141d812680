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
from bundle.graphs.factors import factor_report
from bundle.graphs.factors.factor_report import FactorCheck
from bundle.model.problem import Problem
from bundle.reports.sections import Report, Section, fields
from bundle.reports.terminal.inputs import about_problem, problem_facts


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
    return Report(
        command="check",
        input=about_problem(path, problem),
        headline=[outcome(found)],
        sections=_sections(problem_facts(path, problem), found),
        data=_data(found, options, wall_time),
    )


def checked_function(
    about: dict[str, Any],
    facts: list[tuple[str, str]],
    found: GradientReport,
    options: dict[str, Any],
    wall_time: float,
) -> Report:
    """Return the report on the Jacobians of a function in Python; arguments as of `checked`."""
    return Report(
        command="check",
        input=about,
        headline=[outcome(found)],
        sections=_sections(facts, found),
        data=_data(found, options, wall_time),
    )


def checked_factors(
    about: dict[str, Any],
    facts: list[tuple[str, str]],
    found: FactorCheck,
    options: dict[str, Any],
    wall_time: float,
) -> Report:
    """Return the report on the Jacobians of the factors of a graph.

    Args:
        about: path, format and counts of the input.
        facts: the same for people.
        found: result of the check.
        options: options of the check.
        wall_time: seconds.
    """
    names = ("ok", "verdict", "num_factors", "num_checked", "findings", "groups", "worst")
    return Report(
        command="check",
        input=about,
        headline=[factor_report.outcome(found)],
        sections=[
            Section(text=factor_report.mistakes(found)),
            Section(facts=facts, is_detail=True),
            Section(
                text=factor_report.measurements(found),
                is_joined=True,
                is_detail=found.verdict != "wrong",
            ),
        ],
        data={
            "options": options,
            **{name: getattr(found, name) for name in names},
            "wall_time": {"total": wall_time},
        },
    )


def _sections(facts: list[tuple[str, str]], found: GradientReport) -> list[Section]:
    return [
        Section(text=mistakes(found)),
        Section(facts=facts, text=subject(found), is_detail=True),
        Section(text=measurements(found), is_joined=True, is_detail=found.verdict != "wrong"),
    ]


def _data(found: GradientReport, options: dict[str, Any], wall_time: float) -> dict[str, Any]:
    histogram = [{"low": low, "high": high, "count": count} for low, high, count in found.histogram]
    data = fields(found) | {"histogram": histogram}
    return {
        "options": options,
        **{name: value for name, value in data.items() if name != "details"},
        "wall_time": {"total": wall_time},
    }
