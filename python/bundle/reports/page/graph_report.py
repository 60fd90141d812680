"""Report page of a pose graph or a factor graph: errors by kind, structure, convergence, view."""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.diagnose_graph import NO_MINIMUM
from bundle.base.paths import as_path
from bundle.base.words import amount, number, plural
from bundle.figures.cost_figures import bar_figure, iteration_figure
from bundle.figures.marks import Figure
from bundle.figures.scene_view import SceneView
from bundle.figures.structure_figures import DrawnGraph, error_figure, plan_figures
from bundle.graphs.factors.factor_graph import FactorGraph, GraphResult
from bundle.graphs.pose_graphs.pose_graph_result import (
    ESCAPES,
    STAIRCASE,
    Certificate,
    PoseGraphResult,
)
from bundle.interface.finding import Finding
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.inspection.elimination_costs import CONVENTION, FactorGraphInspection
from bundle.reports.page.graph_facts import (
    ODOMETRY,
    GraphFacts,
    facts_of_factor_graph,
    facts_of_pose_graph,
)
from bundle.reports.page.page import tag, write_page
from bundle.reports.page.scene_section import packed, scene_data, scene_script, scene_section
from bundle.reports.page.table import findings_list, rendered
from bundle.reports.sections import Column, Section, Table
from bundle.reports.terminal.graph_costs import cost_table
from bundle.reports.terminal.graph_headline import (
    about_information,
    certificate_section,
    certificate_sentences,
    kinds_of,
)

MOST_EDGES = 15  # number of edges with the largest chi2 in the table

MOST_DRAWN = 5  # number of edges with the largest chi2 in figures


def write_graph_report(
    source: PoseGraph | PoseGraphResult | FactorGraph,
    path: str | os.PathLike[str],
    *,
    result: GraphResult | None = None,
    name: str = "",
) -> tuple[Finding, ...]:
    """Write the page (see :func:`bundle.report`), and return the problems of the graph."""
    if isinstance(source, FactorGraph):
        facts = facts_of_factor_graph(source, result)
    else:
        facts = facts_of_pose_graph(source)
    found = () if facts.diagnosis is None else facts.diagnosis.findings
    problems = tuple(finding for finding in found if finding.is_problem)
    advice = [
        replace(finding, command=shlex.join(["bundle", "refine", name, "-o", "OUTPUT"]))
        for finding in found
        if finding.kind == NO_MINIMUM and name
    ]
    if isinstance(source, PoseGraphResult):
        advice += about_information(name or "GRAPH", source, kinds_of(source))
    above = {finding.sentence for finding in (*problems, *advice)}
    notes = [finding.sentence for finding in found if finding.sentence not in above]
    drawn = _drawn(facts)
    convergence = [iteration_figure(facts.costs)] if len(facts.costs) > 1 else []
    scene, data = graph_scene(facts, drawn) if facts.dimension == 3 else ("", None)
    sections: list[Section | str] = [
        tag("p", escape(" ".join([*facts.headline[1:], f"{facts.contents}."])), class_="headline"),
        findings_list((*problems, *advice)),
        Section(title="Trajectory", figures=plan_figures(drawn)),
        scene,
        *certificate_sections(source),
        *_errors(facts),
        *_diagnosis(facts, notes),
        *([Section(title="Convergence", figures=convergence)] if convergence else []),
        *([] if facts.inspection is None else [structure_section(facts.inspection)]),
    ]
    kind = "Factor graph" if isinstance(source, FactorGraph) else "Pose graph"
    short = f"{kind} {'/'.join(Path(name).parts[-2:])}".rstrip()
    write_page(
        as_path(path),
        f"{kind} {name}".rstrip(),
        rendered(sections),
        None if data is None else {"scene": data},
        headline=f"{short}: {facts.headline[0].removesuffix('.')}",
        script=scene_script() if data is not None else None,
    )
    return problems


def error_kinds(facts: GraphFacts) -> list[dict[str, Any]]:
    """Return count, chi2 before and after, and expected chi2 of each kind of edges.

    Their ratio is NaN away from a minimum, where the expectation is not valid.
    """
    found = facts.diagnosis
    redundancy = np.full(len(facts.chi2), np.nan) if found is None else found.edge_redundancy
    is_minimum = found is not None and not any(one.kind == NO_MINIMUM for one in found.findings)
    rows = []
    for kind in dict.fromkeys(facts.kinds.tolist()):
        member = facts.kinds == kind
        known = member & np.isfinite(redundancy)
        expected = float(redundancy[known].sum()) if known.any() else math.nan
        is_compared = expected > 0 and is_minimum
        ratio = float(facts.chi2[known].sum()) / expected if is_compared else math.nan
        rows.append({
            "kind": kind, "count": int(member.sum()), "expected": expected, "ratio": ratio,
            "chi2": float(facts.chi2[member].sum()),
            "chi2_before": float(facts.chi2_before[member].sum()),
        })  # fmt: skip
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
    noun, is_solved = facts.noun, facts.before is not None
    kinds = [
        Column(f"kind of {noun}", itemgetter("kind")),
        Column("count", itemgetter("count"), "{:,}".format),
        *[Column("chi2 before", itemgetter("chi2_before"), number)] * is_solved,
        Column("chi2", itemgetter("chi2"), number),
        Column("expected", itemgetter("expected"), number),
        Column("chi2 / expected", itemgetter("ratio"), number),
    ]
    legend = (
        f"Expected: the redundancy of these {noun}s, the part of their errors that others check. "
        "A ratio far below 1: the information is too cautious (sigmas too large); far above 1: "
        f"too optimistic, or some {noun}s are wrong."
    )
    found = facts.diagnosis
    test = np.full(len(facts.chi2), np.nan) if found is None else found.edge_test
    edges = [
        Column(f"worst {noun}s", facts.names.__getitem__),
        Column("kind", facts.kinds.__getitem__),
        *[Column("chi2 before", facts.chi2_before.__getitem__, number)] * is_solved,
        Column("chi2", facts.chi2.__getitem__, number),
        Column("test", test.__getitem__, number),
    ]
    worst = np.argsort(-np.nan_to_num(facts.chi2), kind="stable")[:MOST_EDGES].tolist()
    reading = "Test: r^T K^+ r with K the covariance of the error in the fit."
    figure = error_figure(facts.chi2, facts.sizes, facts.kinds.tolist())
    return [
        Section(
            title="Errors by kind",
            tables=[Table(kinds, error_kinds(facts), legend=legend)],
            figures=[figure] if figure is not None else [],
        ),
        Section(
            title=f"Worst {noun}s", tables=[Table(edges, worst, left=2, most=5, legend=reading)]
        ),
    ]


def _diagnosis(facts: GraphFacts, notes: Sequence[str]) -> list[Section]:
    found = facts.diagnosis
    if found is None:
        return []
    table = [
        ("rank", found.verdict),
        ("connected components", str(len(found.components))),
        ("condition number, scaled", number(found.condition_number)),
        ("digits of a step", f"{found.digits_normal_equations} by normal equations, "
                             f"{found.digits_square_root} by QR"),
    ]  # fmt: skip
    return [Section(title="Certainty", facts=table, notes=notes)]


def structure_section(found: FactorGraphInspection) -> Section:
    """Return the table of the elimination orders."""
    words = f"{plural(found.num_edges, 'pair', grouped=True)} of variables. Without the constant "
    words += f"variables, the matrix has {amount(found.nnz_free)} nonzeros. {found.recommendation}"
    table = cost_table(found)
    table = replace(table, legend=f"{CONVENTION} {table.legend}")
    return Section(title="Structure", text=[escape(words)], tables=[table])


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
    return [replace(facts, title="Certificate", text=text, figures=figures)]


def _costs(solved: PoseGraphResult, found: Certificate) -> Figure:
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
    return [replace(figure, name="minima", title=title)]


def _positions(graph: PoseGraph) -> np.ndarray:
    return graph.poses[:, :2] if graph.dimension == 2 else graph.poses[:, 4:]


# 3-D view of a graph: poses as points and frames, edges as lines (``scene_section.py``).
#
# Poses are drawn as small frusta that look along the x axis of the body, with z up.

MOST_FRAMES = 1500
MOST_POINTS, MOST_LINES = 60_000, 60_000

FIELD = 0.4  # tangent of half the drawn field of view


def graph_scene(facts: GraphFacts, drawn: DrawnGraph) -> tuple[str, dict[str, Any] | None]:
    """Return the section of the view and its data; None without positions."""
    places = drawn.positions
    if not len(places):
        return "", None
    there = facts.is_placed
    rotations = facts.rotations[there]
    low, high = np.quantile(places, [0.02, 0.98], axis=0)
    origin, unit = (low + high) / 2, max(float((high - low).max()) / 2, 1e-12)
    step = max(1, -(-len(places) // MOST_POINTS))
    points = np.arange(0, len(places), step)
    frames = np.arange(0, len(places), max(1, -(-len(places) // MOST_FRAMES)))
    errors = _worst_of_each(facts, there)[points]
    reach = float(np.quantile(np.linalg.norm((places - origin) / unit, axis=1), 0.98))

    def view(positions: NDArray[np.float64]) -> SceneView:
        placed = (positions - origin) / unit
        return SceneView(
            origin=origin,
            unit=unit,
            points=placed[points],
            point_indices=points,
            point_errors=errors,
            step=step,
            num_far=0,
            centers=placed[frames],
            image_indices=frames,
            image_ids=frames,
            axes=rotations[frames][:, :, [1, 2, 0]].transpose(0, 2, 1) * [[-1.0], [-1.0], [1.0]],
            half_fields=np.full((len(frames), 2), FIELD),
            middle=np.zeros(3),
            reach=max(reach, 1e-3),
            up=np.array([0.0, 0, 1]),
            forward=np.array([0.0, 1, 0]),
        )

    now = view(places)
    before = None
    if drawn.before is not None and np.isfinite(drawn.before).all():
        before = view(drawn.before)
    data = scene_data(now, before, error=("worst edge", "chi2"))
    data["frustum"] /= 2
    data["edges"] = {
        "path": _pairs(drawn.path, step, len(points)),
        "others": _pairs(drawn.others, step, len(points)),
    }
    section = scene_section(
        now,
        len(places),
        is_solved=before is not None,
        parts={"points": "poses", "cameras": "frames", "edges": "edges"},
        nouns=("pose", "frame"),
    )
    return section, data


def _worst_of_each(facts: GraphFacts, there: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the largest chi2 of the edges of each variable with a position."""
    worst = np.zeros(len(facts.positions))
    chi2 = np.nan_to_num(facts.chi2)
    for end in (0, 1):
        np.maximum.at(worst, facts.ends[:, end], chi2)
    found: NDArray[np.float64] = worst[there]
    return found


def _pairs(edges: NDArray[np.int64], step: int, count: int) -> str:
    """Return pairs of drawn points, packed; edges of points that are not drawn are left out."""
    kept = edges[(edges % step == 0).all(axis=1)] // step
    kept = kept[(kept < count).all(axis=1)]
    return packed(kept[:: max(1, -(-len(kept) // MOST_LINES))].astype(float))
