"""Report of `bundle check`."""

from __future__ import annotations

from typing import Any

from bundle.checking import gradient_report
from bundle.checking.gradient_report import GradientReport
from bundle.graphs.factors import factor_report
from bundle.graphs.factors.factor_report import FactorCheck
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.reports.sections import Report, Section, fields
from bundle.reports.terminal.inputs import about_input, input_facts

OF_FACTORS = ("ok", "verdict", "num_factors", "num_checked", "findings", "groups", "worst")
"""Properties of a check of factors for programs."""


def checked(
    path: str,
    given: Problem | PoseGraph | None,
    found: GradientReport | FactorCheck,
    options: dict[str, Any],
    wall_time: float,
) -> Report:
    """Return the report on the Jacobians of a problem, a function or factors.

    Args:
        path: path of the input.
        given: problem or pose graph; None for factors and functions in Python.
        found: result of the check.
        options: options of the check.
        wall_time: seconds.
    """
    words: Any = factor_report if isinstance(found, FactorCheck) else gradient_report
    subject = []
    if isinstance(found, FactorCheck):
        data = {name: getattr(found, name) for name in OF_FACTORS}
    else:
        subject = gradient_report.subject(found)
        ends = ("low", "high", "count")
        bins = [dict(zip(ends, one, strict=True)) for one in found.histogram]
        data = fields(found) | {"histogram": bins}
        del data["details"]
    is_detail = found.verdict != "wrong"
    return Report(
        command="check",
        input=about_input(path, given),
        headline=[words.outcome(found)],
        sections=[
            Section(text=words.mistakes(found)),
            Section(facts=input_facts(path, given), text=subject, is_detail=True),
            Section(text=words.measurements(found), is_joined=True, is_detail=is_detail),
        ],
        data={"options": options, **data, "wall_time": {"total": wall_time}},
    )
