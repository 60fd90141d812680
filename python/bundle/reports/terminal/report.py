"""Report of `bundle report` about the page that it wrote."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bundle.base.memory_sizes import format_size
from bundle.base.words import contents
from bundle.errors import shown
from bundle.interface.finding import Finding
from bundle.model.problem import Problem
from bundle.reports.sections import Report, Section
from bundle.reports.terminal.inputs import about_problem, problem_facts

__all__ = ["reported"]


def reported(
    path: str,
    problem: Problem,
    page: str,
    notes: Sequence[str],
    wall_time: float,
    findings: Sequence[Finding] = (),
) -> Report:
    """Return the report.

    Args:
        path: path of the input.
        problem: problem on the page.
        page: path of the page.
        notes: sentences about missing parts of the page.
        wall_time: seconds.
        findings: findings about the problem.
    """
    size = f" ({format_size(Path(page).stat().st_size)})" if Path(page).is_file() else ""
    return Report(
        command="report",
        input=about_problem(path, problem),
        headline=[f"Wrote {shown(page)}{size}: {contents(problem)}."],
        warnings=notes,
        findings=findings,
        sections=[Section(facts=problem_facts(path, problem, rigs=True), is_detail=True)],
        data={
            "notes": notes,
            "wall_time": {"total": wall_time},
            "output": {"path": page, "format": "html"},
        },
    )
