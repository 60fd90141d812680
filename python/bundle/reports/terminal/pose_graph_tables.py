"""Reports of `bundle refine` and `bundle info` on pose graphs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bundle.base.own_process import Waiting
from bundle.base.words import few, number, plural
from bundle.errors import InputError
from bundle.graphs.pose_graphs.edge_weights import (
    bad_information,
    densest_set,
    describe_information,
    pose_graph_chi2,
)
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.pose_graph_options import POSE_ERRORS, PoseGraphOptions
from bundle.model.content_digests import content_digests
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.reports.sections import Column, Report, Section, Table, records
from bundle.reports.terminal.graph_headline import (
    KINDS,
    about_information,
    certificate_data,
    certificate_section,
    degrees_of_freedom,
    graph_headline,
    kinds_of,
)
from bundle.reports.terminal.inputs import about_input, contents_of, input_facts, written
from bundle.reports.terminal.solve_data import (
    WallTime,
    environment_data,
    factor_fact,
    solve_options,
    wall_section,
)

MOST_REJECTED = 20  # number of rejected edges shown
MOST_EDGES = 5  # number of edges with the largest chi2 shown
UNFIT = 10.0  # chi2 per degree of freedom above which poses do not fit their edges
MOST_BAD = 10  # number of listed edges with invalid information

_LINE = Column("line", lambda edge: edge.line or "-")

REJECTED = (
    Column("rejected edges", "name"),
    _LINE,
    Column("chi2", "chi2", number),
    Column("weight", "weight", number),
)
LEFT_OUT = (
    Column("closures left out", "name"),
    _LINE,
    Column("chi2 of worst pair", "entry.chi2", number),
    Column("contradicts", "entry.num_contradicted"),
)
WORST = (
    Column("worst edges, after", "name"),
    Column("", lambda edge: "closure" if edge.is_closure else "odometry"),
    Column("chi2 before", "chi2_before", number),
    Column("chi2 after", "chi2", number),
)


class _Edge:
    """Edge of a solved graph, given by its index."""

    def __init__(self, solved: PoseGraphResult, index: int, entry: Any = None) -> None:
        graph = solved.problem
        self.ids = graph.ids[graph.edges[index]].tolist()
        self.name = " ".join(map(str, self.ids))
        self.line = int(graph.edge_lines[index]) or None
        self.is_closure = bool(graph.is_closure[index])
        self.chi2_before = float(solved.chi2_before[index])
        self.chi2 = float(solved.chi2_after[index])
        self.weight = float(solved.weights[index])
        self.entry = entry


def _said(graph: PoseGraph) -> list[str]:
    return [f"{note[0].upper()}{note[1:]}." for note in graph.notes]


def refined_graph(
    path: str,
    solved: PoseGraphResult,
    wall: WallTime,
    output: dict[str, str] | None,
    waiting: Waiting | None = None,
) -> Report:
    """Return the report on one solve; `output` is None if nothing was written."""
    summary, graph = solved.summary, solved.initial_problem
    facts = [
        *input_facts(path, graph),
        ("error", _error(solved.options)),
        *((("loss", summary.loss_choice),) if summary.loss_choice else ()),
        ("gauge", _gauge(solved)),
        ("start", summary.init.replace("_", " ")),
        *((("", summary.init_choice),) if summary.init_choice else ()),
        ("backend", summary.backend_used),
        (
            "solver",
            f"{summary.linear_solver_type_used} on {plural(summary.num_threads_used, 'thread')}",
        ),
        *factor_fact(summary),
    ]
    before_and_after = [
        ("chi2", f"{summary.chi2_initial:.12g}", f"{summary.chi2_final:.12g}"),
        ("cost", f"{summary.initial_cost:.12g}", f"{summary.final_cost:.12g}"),
    ]
    rejected = [_Edge(solved, index) for index in solved.rejected]
    left_out = [_Edge(solved, entry.edge, entry) for entry in solved.left_out]
    kinds = kinds_of(solved)
    details = [
        Section(facts=facts),
        Section(tables=[Table.of(("", "before", "after"), before_and_after)]),
        *([Section(tables=[Table(KINDS, kinds)])] if kinds else []),
        *certificate_section(solved),
        *_verdicts(solved, rejected, left_out),
        wall_section(summary, wall),
    ]
    return Report(
        command="refine",
        input=about_input(path, graph) | {"digests": content_digests(graph)},
        headline=graph_headline(solved),
        findings=about_information(path, solved, kinds),
        warnings=(*_said(graph), *summary.warnings),
        sections=[
            Section(facts=[written(output, path)]),
            *(replace(section, is_detail=True) for section in details),
        ],
        data={
            "options": solve_options(solved.options),
            "summary": summary,
            **certificate_data(solved.certificate),
            "iterations": records(solved.iterations),
            "rejected_edges": [
                {"edge": one.ids, "line": one.line, "chi2": one.chi2, "weight": one.weight}
                for one in rejected
            ],
            "left_out_edges": [
                {
                    "edge": one.ids,
                    "line": one.line,
                    "pair_chi2": one.entry.chi2,
                    "num_contradicted": one.entry.num_contradicted,
                    "chi2": one.chi2,
                }
                for one in left_out
            ],
            "chi2_by_kind": kinds,
            "structure": {"densest": densest_set(graph.edges)},
            "wall_time": wall,
            "environment": environment_data(waiting),
            "output": output,
        },
    )


def _verdicts(
    solved: PoseGraphResult, rejected: list[_Edge], left_out: list[_Edge]
) -> list[Section]:
    out = {entry.edge for entry in solved.left_out}
    order = np.argsort(-solved.chi2_after, kind="stable").tolist()
    worst = [_Edge(solved, index) for index in order if index not in out][:MOST_EDGES]
    sections = []
    if len(solved.chi2_after) > 1:
        sections.append(Section(tables=[Table(WORST, worst, left=2)]))
    is_checked = solved.options.consistency
    more = " (--json FILE lists all)"
    if is_checked:
        closures = plural(int(solved.problem.is_closure.sum()), "closure")
        many = more if len(left_out) > MOST_REJECTED else ""
        if left_out:
            sections.append(Section(tables=[Table(LEFT_OUT, left_out[:MOST_REJECTED])]))
        sections.append(Section(facts=[("left out", f"{len(left_out)} of {closures}{many}")]))
    if solved.options.loss != "trivial":
        many = more if len(rejected) > MOST_REJECTED else ""
        if rejected:
            table = Table(REJECTED, rejected[:MOST_REJECTED])
            sections.append(Section(tables=[table], is_joined=is_checked))
        words = plural(len(rejected), "edge") + many
        joined = is_checked and not rejected
        sections.append(Section(facts=[("rejected", words)], is_joined=joined))
    return sections


def described_graph(path: str, graph: PoseGraph) -> Report:
    """Return the report of `bundle info`: counts, components, current chi2, suspicions."""
    bad = bad_information(graph)
    chi2: dict[str, float | None] = dict.fromkeys(POSE_ERRORS)
    for error in chi2:
        try:
            chi2[error] = float(pose_graph_chi2(graph, error).sum())
        except InputError:  # invalid information matrices, which are listed
            break
    degrees = degrees_of_freedom(graph)
    listed = [
        {
            "edge": graph.ids[graph.edges[edge]],
            "line": int(graph.edge_lines[edge]) or None,
            "sentence": f"{graph.edge_name(edge)}: information: "
            f"{describe_information(graph, edge)}",
        }
        for edge in bad[:MOST_BAD]
    ]
    facts = [
        *input_facts(path, graph),
        ("dimension", str(graph.dimension)),
        ("components", str(graph.num_components)),
        (
            "poses",
            "from the file" if graph.has_poses else "composed from the edges: the file has none",
        ),
        ("redundancy", f"{degrees} degrees of freedom"),
        *(
            (f"chi2 now, {error}", number(value) if value is not None else "-")
            for error, value in chi2.items()
        ),
    ]
    wrong = [str(entry["sentence"]) for entry in listed]
    if len(bad) > len(listed):
        wrong.append(f"{len(bad) - len(listed)} more edges have such information")
    if graph.num_components > 1:
        wrong.append(f"no edge joins the {graph.num_components} components of the graph")
    return Report(
        command="info",
        input=about_input(path, graph),
        headline=[
            _contents(graph, chi2, degrees),
            _suspicion(len(bad), bool(wrong), (chi2[POSE_ERRORS[0]] or 0.0) / max(degrees, 1)),
        ],
        warnings=[*_said(graph), *wrong],
        sections=[Section(facts=facts, is_detail=True)],
        data={
            "num_components": graph.num_components,
            "chi2": chi2,
            "degrees_of_freedom": degrees,
            "num_bad_information": len(bad),
            "bad_information": listed,
        },
    )


def _contents(graph: PoseGraph, chi2: dict[str, float | None], degrees: int) -> str:
    now = chi2[POSE_ERRORS[0]]
    if now is None:
        return f"{contents_of(graph)}; chi2 is unknown."
    share = f", {number(now / degrees)} per degree of freedom" if degrees > 0 else ""
    return f"{contents_of(graph)}; chi2 now {number(now)}{share}."


def _suspicion(num_bad: int, is_wrong: bool, ratio: float) -> str:
    """Return a sentence; ``ratio``: chi2 per degree of freedom, 0 if unknown."""
    if num_bad:
        edges = plural(num_bad, "edge has", "edges have", grouped=True)
        return f"{edges} no valid information matrix."
    if is_wrong:
        return "It looks wrong:"
    if ratio > UNFIT:
        return "Its poses do not fit its edges yet: refine it (bundle refine)."
    return "Nothing looks wrong."


def _error(options: PoseGraphOptions) -> str:
    words = [options.error]
    if options.information != "file":
        words.append(f"{options.information} information")
    if options.loss != "trivial":
        loss = options.loss.replace("_", "-")
        words.append(f"{loss} loss at {options.loss_scale:g} sigma on {options.loss_on}")
    return "; ".join(words)


def _gauge(solved: PoseGraphResult) -> str:
    summary = solved.summary
    if not summary.held_pose_ids:
        return "held by fixed poses"
    noun = "pose" if len(summary.held_pose_ids) == 1 else "poses"
    ids = few(summary.held_pose_ids)
    return f"{summary.num_gauge_freedoms} degrees of freedom: {noun} {ids} held"
