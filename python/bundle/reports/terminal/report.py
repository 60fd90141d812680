"""Report of `bundle report` about the page that it wrote."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bundle.base.words import contents, format_size
from bundle.errors import shown
from bundle.interface.finding import Finding
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.problem import Problem
from bundle.reports.sections import Report, Section
from bundle.reports.terminal.inputs import (
    about_graph,
    about_problem,
    contents_of_graph,
    graph_facts,
    problem_facts,
)


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
    return _written(
        about_problem(path, problem),
        contents(problem),
        problem_facts(path, problem, rigs=True),
        page,
        notes,
        wall_time,
        findings,
    )


def reported_graph(
    path: str, graph: PoseGraph, page: str, wall_time: float, findings: Sequence[Finding]
) -> Report:
    """Return the report about the page of a pose graph."""
    facts, about = graph_facts(path, graph), about_graph(path, graph)
    return _written(about, contents_of_graph(graph), facts, page, (), wall_time, findings)


def _written(
    about: dict[str, Any],
    words: str,
    facts: Sequence[tuple[str, str]],
    page: str,
    notes: Sequence[str],
    wall_time: float,
    findings: Sequence[Finding],
) -> Report:
    size = f" ({format_size(Path(page).stat().st_size)})" if Path(page).is_file() else ""
    return Report(
        command="report",
        input=about,
        headline=[f"Wrote {shown(page)}{size}: {words}."],
        warnings=notes,
        findings=findings,
        sections=[Section(facts=facts, is_detail=True)],
        data={
            "notes": notes,
            "wall_time": {"total": wall_time},
            "output": {"path": page, "format": "html"},
        },
    )
