"""Certificate on the report page of a pose graph: verdict, numbers, bounds as bars, both minima."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from bundle.base.words import number, plural
from bundle.figures.cost_figures import bar_figure
from bundle.figures.drawing import Figure
from bundle.figures.graph_figures import DrawnGraph, plan_figures
from bundle.graphs.pose_graphs.certificate import ESCAPES, STAIRCASE, Certificate
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.reports.sections import Section, Table
from bundle.reports.terminal.certificate_facts import certificate_sentences

LEGEND = (
    "The eigenvalue is the smallest one of the certificate matrix, 0 up to rounding if certified; "
    "the next one tells how isolated the optimum is. F: chordal cost, without a factor 1/2."
)


def certificate_sections(solved: object) -> list[Section]:
    """Return the section of a result with a certificate; otherwise an empty list."""
    if not isinstance(solved, PoseGraphResult) or solved.certificate is None:
        return []
    found = solved.certificate
    head = ["", "verdict", "F", "at least", "gap", "eigenvalue", "next", "effort"]
    rows = [
        [
            "minimum of the solve", found.verdict, f"{found.cost:.9g}",
            number(found.lower_bound), number(found.gap), f"{found.min_eigenvalue:.6g}",
            _next(found.eigenvalues, found.min_eigenvalue), plural(found.num_steps, "Newton step"),
        ]
    ]  # fmt: skip
    stairs = found.staircase
    if stairs is not None:
        rows.append([
            "after the staircase", stairs.verdict, f"{stairs.cost:.9g}",
            number(stairs.lower_bound), number(stairs.gap), f"{stairs.min_eigenvalue:.6g}",
            _next(stairs.eigenvalues, stairs.min_eigenvalue), f"rank {stairs.rank}",
        ])  # fmt: skip
    return [
        Section(
            title="Certificate",
            text=[" ".join(certificate_sentences(solved))],
            tables=[Table.of(head, rows, left=2, legend=LEGEND)],
            figures=[_costs(solved, found), *_minima(solved, found)],
        )
    ]


def _next(eigenvalues: np.ndarray, smallest: float) -> str:
    """Return the first eigenvalue above the smallest one."""
    above = [value for value in eigenvalues.tolist() if value > smallest]
    return f"{above[0]:.6g}" if above else "-"


def _costs(solved: PoseGraphResult, found: Certificate) -> Figure:
    """Return chi2 and F with their lower bounds, as bars."""
    has_escaped = solved.summary.init in ESCAPES
    values = {"chi2, first solution" if has_escaped else "chi2": found.chi2}
    if has_escaped:
        values["chi2"] = solved.summary.chi2_final
    values["chi2 of any poses, at least"] = found.chi2_lower_bound
    values["F, minimum of the solve"] = found.cost
    bound = found.lower_bound
    if found.staircase is not None:
        values["F, after the staircase"] = found.staircase.cost
        bound = max(bound, found.staircase.lower_bound)
    values["F of any poses, at least"] = bound
    positive = {name: value for name, value in values.items() if math.isfinite(value) and value > 0}
    return bar_figure("bounds", "Costs and their lower bounds, on a log scale", positive, number)


def _minima(solved: PoseGraphResult, found: Certificate) -> list[Figure]:
    """Return the trajectory of the solve's first minimum, below that of the result."""
    if solved.summary.init != STAIRCASE:
        return []
    graph = solved.problem
    along = ~graph.is_closure
    ends = graph.edges.astype(np.int64)
    drawn = DrawnGraph(
        positions=_positions(graph),
        before=_positions(found.problem),
        path=ends[along],
        others=ends[~along],
        worst=np.empty((0, 2), np.int64),
    )
    figure = plan_figures(drawn)[0]
    title = "The first minimum (before) and the result"
    return [dataclasses.replace(figure, name="minima", title=title)]


def _positions(graph: PoseGraph) -> np.ndarray:
    return graph.poses[:, :2] if graph.dimension == 2 else graph.poses[:, 4:]
