"""What `bundle inspect --graph` says: the elimination of a graph, step by step."""

from __future__ import annotations

import dataclasses
from typing import Any

from rich.console import RenderableType

from bundle._core import __version__
from bundle.base.tables import columns, facts, number, plural
from bundle.errors import shown
from bundle.planning.inspection.graph_inspection import GraphInspection
from bundle.reports.terminal import json
from bundle.reports.terminal.inspect import CONVENTION

__all__ = ["as_json", "inspected"]

# Steps, and members of a step, beyond which a terminal shows no more.
MOST_STEPS, MOST_MEMBERS = 100, 8


def inspected(path: str, graph: GraphInspection) -> list[RenderableType]:
    """Return the steps of an elimination and its bill."""
    sizes = f"{plural(graph.num_variables, 'variable')}, {plural(len(graph.edges), 'edge')}"
    counts = " ".join(map(str, graph.column_counts[:MOST_STEPS]))
    more = " ..." if len(graph.column_counts) > MOST_STEPS else ""
    return [
        facts([("graph", shown(path)), ("", sizes), ("ordering", graph.ordering)]),
        "",
        columns(
            ("eliminated", "neighbours", "fill", "flops", "fill so far", "so far"),
            _rows(graph),
            left=3,
        )
        if graph.steps
        else "Too many neighbours to record the steps of the elimination.",
        "",
        facts(
            [
                ("column counts", counts + more),
                ("fill", str(graph.fill)),
                ("flops", f"{graph.flops} (CHOLMOD's own count: {number(graph.cholmod_flops)})"),
                ("nonzeros", f"{graph.nnz} of the matrix, {graph.nnz_factor} of its factor L"),
                ("", CONVENTION),
                ("tree height", str(graph.tree_height)),
            ]
        ),
    ]


def as_json(path: str, graph: GraphInspection, wall_time: float) -> dict[str, Any]:
    """Return the report of `bundle inspect --graph` for programs; wall_time in seconds."""
    return {
        "schema": json.SCHEMA,
        "command": "inspect",
        "version": __version__,
        "graph": path,
        **json.plain(dataclasses.asdict(graph)),
        "nonzeros": CONVENTION,
        "wall_time": {"total": wall_time},
    }


def _rows(graph: GraphInspection) -> list[tuple[str, ...]]:
    names = graph.names
    rows: list[tuple[str, ...]] = [
        (
            names[step.variable],
            _members([names[neighbour] for neighbour in step.neighbours]),
            _members([f"{names[a]}-{names[b]}" for a, b in step.fill]),
            str(step.flops),
            str(step.total_fill),
            str(step.total_flops),
        )
        for step in graph.steps[:MOST_STEPS]
    ]
    if len(graph.steps) > MOST_STEPS:
        rows.append((f"... {len(graph.steps) - MOST_STEPS} more", "", "", "", "", ""))
    return rows


def _members(members: list[str]) -> str:
    shown_members = " ".join(members[:MOST_MEMBERS])
    return shown_members + (
        f" +{len(members) - MOST_MEMBERS}" if len(members) > MOST_MEMBERS else ""
    )
