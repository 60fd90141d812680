"""Report page of a pose graph or a factor graph: errors by kind, structure, convergence, views."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from bundle.base.paths import as_path
from bundle.base.words import amount, number, plural
from bundle.figures.cost_figures import iteration_figure
from bundle.figures.graph_figures import DrawnGraph, error_figure, plan_figures
from bundle.graphs.factors.factor_graph import FactorGraph, GraphResult
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.finding import Finding
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.inspection.elimination_costs import CONVENTION
from bundle.planning.inspection.factor_graph_inspection import FactorGraphInspection
from bundle.planning.inspection.pose_graph_inspection import PoseGraphInspection
from bundle.reports.page.certificate_section import certificate_sections
from bundle.reports.page.graph_facts import (
    ODOMETRY,
    GraphFacts,
    facts_of_factor_graph,
    facts_of_pose_graph,
)
from bundle.reports.page.graph_scene import graph_scene
from bundle.reports.page.page import tag, write_page
from bundle.reports.page.scene_section import scene_script
from bundle.reports.page.section_markup import findings_list, rendered
from bundle.reports.sections import Section, Table
from bundle.reports.terminal.graph_costs import cost_table, matrix_size

MOST_EDGES = 15
"""Number of edges with the largest chi2 in the table."""

MOST_DRAWN = 5
"""Number of edges with the largest chi2 in figures."""


def write_graph_report(
    source: PoseGraph | PoseGraphResult | FactorGraph,
    path: str | os.PathLike[str],
    *,
    result: GraphResult | None = None,
    name: str = "",
) -> tuple[Finding, ...]:
    """Write the page; see :func:`bundle.report`.

    Returns:
        Problems of the graph; the page has the same sentences.

    Raises:
        InputError: the graph has nothing to estimate, or the path cannot hold a page.
        OSError: the page cannot be written.
    """
    if isinstance(source, FactorGraph):
        facts = facts_of_factor_graph(source, result)
    else:
        facts = facts_of_pose_graph(source)
    found = () if facts.diagnosis is None else facts.diagnosis.findings
    problems = tuple(finding for finding in found if finding.is_problem)
    notes = [finding.sentence for finding in found if not finding.is_problem]
    drawn = _drawn(facts)
    scene, data = graph_scene(facts, drawn) if facts.dimension == 3 else ("", None)
    sections: list[Section | str] = [
        tag(
            "p",
            tag("strong", escape(facts.headline[0])),
            " ",
            escape(" ".join(facts.headline[1:])),
            class_="headline",
        ),
        findings_list(problems),
        Section(title="Trajectory", figures=plan_figures(drawn)),
        scene,
        *certificate_sections(source),
        *_errors(facts),
        *_diagnosis(facts, notes),
        *_convergence(facts),
        *([] if facts.inspection is None else [structure_section(facts.inspection)]),
    ]
    short = "/".join(Path(name).parts[-2:]) or f"A graph of {facts.noun}s"
    write_page(
        as_path(path),
        f"Report on {name}" if name else "Report on a graph",
        rendered(sections),
        None if data is None else {"scene": data},
        headline=f"{short}: {facts.contents}",
        script=scene_script() if data is not None else None,
    )
    return problems


def error_kinds(facts: GraphFacts) -> list[dict[str, Any]]:
    """Return count, chi2 before and after, and expected chi2 of each kind of edges.

    The ratio of both is NaN away from a minimum, where the expectation does not hold.
    """
    redundancy = np.full(len(facts.chi2), np.nan)
    if facts.diagnosis is not None:
        redundancy = facts.diagnosis.edge_redundancy
    is_minimum = facts.diagnosis is not None and not any(
        finding.kind == "no_minimum" for finding in facts.diagnosis.findings
    )
    rows = []
    for kind in dict.fromkeys(facts.kinds.tolist()):
        member = facts.kinds == kind
        known = member & np.isfinite(redundancy)
        expected = float(redundancy[known].sum())
        rows.append(
            {
                "kind": kind,
                "count": int(member.sum()),
                "chi2_before": float(facts.chi2_before[member].sum()),
                "chi2": float(facts.chi2[member].sum()),
                "expected": expected if known.any() else float("nan"),
                "ratio": float(facts.chi2[known].sum()) / expected
                if expected > 0 and is_minimum
                else float("nan"),
            }
        )
    return rows


def _drawn(facts: GraphFacts) -> DrawnGraph:
    """Return the positions to draw; the trajectory is odometry, or factors of successive poses."""
    there = facts.is_placed
    row = np.cumsum(there) - 1
    kept = there[facts.ends].all(axis=1) & (facts.ends[:, 0] != facts.ends[:, 1])
    ends = row[facts.ends[kept]]
    if facts.noun == "edge":
        along = facts.kinds[kept] == ODOMETRY
    else:
        along = np.abs(ends[:, 0] - ends[:, 1]) == 1
    order = np.argsort(-np.where(np.isfinite(facts.chi2), facts.chi2, 0.0), kind="stable")
    worst = [k for k in order[:MOST_DRAWN] if kept[k]]
    return DrawnGraph(
        positions=facts.positions[there],
        before=None if facts.before is None else facts.before[there],
        path=ends[along],
        others=ends[~along],
        worst=row[facts.ends[worst]].reshape(-1, 2),
    )


def _errors(facts: GraphFacts) -> list[Section]:
    is_solved = facts.before is not None
    head = [f"kind of {facts.noun}", "count", *(["chi2 before"] if is_solved else []), "chi2",
            "expected", "chi2 / expected"]  # fmt: skip
    rows = [
        [
            row["kind"],
            f"{row['count']:,}",
            *([number(row["chi2_before"])] if is_solved else []),
            number(row["chi2"]),
            _known(row["expected"]),
            _known(row["ratio"]),
        ]
        for row in error_kinds(facts)
    ]
    legend = (
        f"Expected: the redundancy of these {facts.noun}s, the part of their errors that others "
        "check. A ratio far below 1: the information is too cautious; far above 1: too optimistic, "
        f"or some {facts.noun}s are wrong."
    )
    test = None if facts.diagnosis is None else facts.diagnosis.edge_test
    worst = [
        [
            facts.names[k],
            str(facts.kinds[k]),
            *([number(facts.chi2_before[k])] if is_solved else []),
            number(facts.chi2[k]),
            _known(float("nan") if test is None else float(test[k])),
        ]
        for k in np.argsort(-np.nan_to_num(facts.chi2), kind="stable")[:MOST_EDGES].tolist()
    ]
    worst_head = [f"worst {facts.noun}s", "kind", *(["chi2 before"] if is_solved else []), "chi2",
                  "test"]  # fmt: skip
    figure = error_figure(facts.chi2, facts.sizes, facts.kinds.tolist())
    return [
        Section(
            title="Errors by kind",
            tables=[Table.of(head, rows, legend=legend)],
            figures=[figure] if figure is not None else [],
        ),
        Section(
            title=f"Worst {facts.noun}s",
            tables=[
                Table.of(
                    worst_head,
                    worst,
                    left=2,
                    legend="Test: r^T K^+ r with K the covariance of the error in the fit.",
                )
            ],
        ),
    ]


def _known(value: float) -> str:
    return number(value) if np.isfinite(value) else "-"


def _diagnosis(facts: GraphFacts, notes: Sequence[str]) -> list[Section]:
    found = facts.diagnosis
    if found is None:
        return []
    table = [
        ("rank", found.verdict),
        ("connected components", str(len(found.components))),
        ("condition number, scaled", _known(found.condition_number)),
        ("digits of a step", f"{found.digits_normal_equations} by normal equations, "
                             f"{found.digits_square_root} by QR"),
    ]  # fmt: skip
    return [Section(title="Certainty", facts=table, notes=notes)]


def _convergence(facts: GraphFacts) -> list[Section]:
    if len(facts.costs) < 2:
        return []
    return [Section(title="Convergence", figures=[iteration_figure(facts.costs)])]


def structure_section(found: PoseGraphInspection | FactorGraphInspection) -> Section:
    """Return the table of the elimination orders."""
    words = f"{plural(found.num_edges, 'pair', grouped=True)} of variables; without constant ones "
    words += f"the matrix has {amount(matrix_size(found)[1])} nonzeros. {found.recommendation}"
    table = cost_table(found)
    table = replace(table, legend=f"{CONVENTION} {table.legend}")
    return Section(title="Structure", text=[escape(words)], tables=[table])
