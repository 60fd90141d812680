"""Certificate on the report page of a pose graph: verdict, numbers, bounds as bars, both minima."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from bundle.base.words import number
from bundle.figures.cost_figures import bar_figure
from bundle.figures.drawing import Figure
from bundle.figures.graph_figures import DrawnGraph, plan_figures
from bundle.graphs.pose_graphs.pose_graph_result import (
    ESCAPES,
    STAIRCASE,
    Certificate,
    PoseGraphResult,
)
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.reports.sections import Section
from bundle.reports.terminal.certificate_facts import certificate_section, certificate_sentences

LEGEND = (
    "The eigenvalue is the smallest one of the certificate matrix, 0 up to rounding if certified; "
    "the next one tells how isolated the optimum is. F: chordal cost, without a factor 1/2."
)


def certificate_sections(solved: object) -> list[Section]:
    """Return the section of a result with a certificate; otherwise an empty list."""
    if not isinstance(solved, PoseGraphResult) or solved.certificate is None:
        return []
    found = solved.certificate
    figures = [_costs(solved, found), *_minima(solved, found)]
    text = [" ".join(certificate_sentences(solved)), LEGEND]
    (facts,) = certificate_section(solved)
    return [dataclasses.replace(facts, title="Certificate", text=text, figures=figures)]


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
