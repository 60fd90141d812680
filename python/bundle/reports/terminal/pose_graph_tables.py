"""What commands print about pose graphs."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import RenderableType

from bundle.base.tables import columns, facts, notes, number, plural, seconds
from bundle.errors import shown
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.summary import Summary
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.reports.terminal.timing import WallTime, wall_table

__all__ = ["contents_of_graph", "converted_graph", "described_graph", "refined_graph"]

MOST_REJECTED = 20
"""Rejected edges that are shown."""

MOST_EDGES = 5
"""Edges with the largest chi2 that are shown."""


def refined_graph(
    path: str, solved: PoseGraphResult, wall: WallTime, output: dict[str, str] | None
) -> list[RenderableType]:
    """Return the report on one solve; `output` is None where nothing was written."""
    summary, graph = solved.summary, solved.initial_problem
    rows = [
        ("input", f"{shown(path)} (g2o)"),
        ("", contents_of_graph(graph)),
        *(("", note) for note in graph.notes),
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
        *((("factor", _factor(summary)),) if summary.num_factor_nonzeros is not None else ()),
    ]
    before_and_after = [
        ("chi2", f"{summary.chi2_initial:.12g}", f"{summary.chi2_final:.12g}"),
        ("cost", f"{summary.initial_cost:.12g}", f"{summary.final_cost:.12g}"),
    ]
    written = f"{shown(output['path'])} (g2o)" if output else "nothing was written"
    return [
        facts(rows),
        "",
        columns(("", "before", "after"), before_and_after),
        "",
        *_worst(solved),
        *_left_out(solved),
        *_rejected(solved),
        facts([("outcome", solved.outcome)]),
        *notes(summary.warnings, style="yellow"),
        "",
        wall_table(summary, wall),
        "",
        facts([("output", written)]),
    ]


def described_graph(path: str, graph: PoseGraph, report: dict[str, Any]) -> list[RenderableType]:
    """Return what `bundle info` says; ``report`` is what it says to programs."""
    chi2 = report["chi2"]
    sizes = [
        ("input", f"{shown(path)} (g2o)"),
        ("", contents_of_graph(graph)),
        *(("", note) for note in graph.notes),
        ("dimension", str(graph.dimension)),
        ("components", str(report["num_components"])),
        ("poses", "of the file" if graph.has_poses else "composed of edges: the file has none"),
        ("redundancy", f"{report['degrees_of_freedom']} degrees of freedom"),
        *(
            (f"chi2 now, {error}", number(value) if value is not None else "-")
            for error, value in chi2.items()
        ),
    ]
    bad = [entry["sentence"] for entry in report["bad_information"]]
    count = report["num_bad_information"]
    wrong = bad + [f"{count - len(bad)} more edges have such information"] * (count > len(bad))
    if report["num_components"] > 1:
        wrong.append(f"no edge joins the {report['num_components']} components of the graph")
    return [
        facts(sizes),
        facts([("looks wrong", "" if wrong else "nothing found")]),
        *notes(wrong, style="yellow"),
    ]


def converted_graph(path: str, graph: PoseGraph, output: dict[str, str]) -> list[RenderableType]:
    """Return what was read and what was written."""
    rows = [
        ("input", f"{shown(path)} (g2o)"),
        ("", contents_of_graph(graph)),
        *(("", note) for note in graph.notes),
        ("output", f"{shown(output['path'])} (g2o)"),
        ("lost", "nothing"),
    ]
    return [facts(rows)]


def contents_of_graph(graph: PoseGraph) -> str:
    """Return "12 poses, 17 edges, 6 closures, 1 pose fixed"."""
    counts = [
        plural(graph.num_poses, "pose"),
        plural(graph.num_edges, "edge"),
        plural(int(graph.is_closure.sum()), "closure"),
    ]
    fixed = int(graph.fixed.sum())
    return ", ".join(counts) + (f", {plural(fixed, 'pose')} fixed" if fixed else "")


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
    ids = ", ".join(map(str, summary.held_pose_ids[:3]))
    more = len(summary.held_pose_ids) - 3
    others = f" and {more} more" if more > 0 else ""
    noun = "pose" if len(summary.held_pose_ids) == 1 else "poses"
    return f"{summary.num_gauge_freedoms} degrees of freedom: {noun} {ids}{others} held"


def _factor(summary: Summary) -> str:
    return (
        f"{plural(summary.num_factor_columns or 0, 'column')}, {summary.factor_ordering} order, "
        f"{number(summary.num_factor_nonzeros or 0)} nonzeros, "
        f"{number(summary.factor_flops or 0.0)} flops, analysed in "
        f"{seconds(summary.symbolic_time_in_seconds or 0.0)} s"
    )


def _rejected(solved: PoseGraphResult) -> list[RenderableType]:
    """Return the edges that the loss rejected; nothing without a loss."""
    if solved.options.loss == "trivial":
        return []
    graph = solved.problem
    rows = [
        (
            " ".join(map(str, graph.ids[graph.edges[edge]])),
            str(int(graph.edge_lines[edge]) or "-"),
            number(solved.chi2_after[edge]),
            number(solved.weights[edge]),
        )
        for edge in solved.rejected[:MOST_REJECTED]
    ]
    more = len(solved.rejected) - len(rows)
    named: list[RenderableType] = (
        [columns(("rejected edges", "line", "chi2", "weight"), rows), ""] if rows else []
    )
    sentence = plural(len(solved.rejected), "edge") + (" (--json FILE lists all)" if more else "")
    return [*named, facts([("rejected", sentence)])]


def _left_out(solved: PoseGraphResult) -> list[RenderableType]:
    """Return the closures outside the largest consistent set; nothing where it was not sought."""
    if not solved.options.consistency:
        return []
    graph = solved.problem
    rows = [
        (
            " ".join(map(str, graph.ids[graph.edges[entry.edge]])),
            str(int(graph.edge_lines[entry.edge]) or "-"),
            number(entry.chi2),
            str(entry.num_contradicted),
        )
        for entry in solved.left_out[:MOST_REJECTED]
    ]
    more = len(solved.left_out) > len(rows)
    head = ("closures left out", "line", "chi2 of worst pair", "contradicts")
    named: list[RenderableType] = [columns(head, rows), ""] if rows else []
    closures = plural(int(graph.is_closure.sum()), "closure")
    sentence = f"{len(solved.left_out)} of {closures}" + (
        " (--json FILE lists all)" if more else ""
    )
    return [*named, facts([("left out", sentence)])]


def _worst(solved: PoseGraphResult) -> list[RenderableType]:
    chi2, graph = solved.chi2_after, solved.problem
    if len(chi2) < 2:
        return []
    closure = graph.is_closure
    rows = []
    solved_with = np.ones(len(chi2), bool)
    solved_with[[entry.edge for entry in solved.left_out]] = False
    worst = [edge for edge in np.argsort(-chi2, kind="stable") if solved_with[edge]]
    for edge in worst[:MOST_EDGES]:
        first, second = graph.ids[graph.edges[edge]]
        kind = "closure" if closure[edge] else "odometry"
        before = solved.chi2_before[edge]
        rows.append((f"{first} {second}", kind, number(before), number(chi2[edge])))
    head = ("worst edges, after", "", "chi2 before", "chi2 after")
    return [columns(head, rows, left=2), ""]
