"""Report of `bundle inspect --graph`: the steps of an elimination and their cost."""

from __future__ import annotations

from collections.abc import Sequence

from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.planning.inspection.elimination_costs import CONVENTION
from bundle.planning.inspection.graph_inspection import GraphInspection
from bundle.reports.sections import Column, Report, Section, Table, fields

# Largest number of steps, and of members of a step, that a terminal shows.
MOST_STEPS, MOST_MEMBERS = 100, 8

SHORT = 12
"""Number of steps up to which they are shown without --verbose."""


def inspected(path: str, graph: GraphInspection, wall_time: float) -> Report:
    """Return the report; wall_time in seconds."""
    sizes = f"{plural(graph.num_variables, 'variable')}, {plural(len(graph.edges), 'edge')}"
    counts = " ".join(map(str, graph.column_counts[:MOST_STEPS]))
    more = " ..." if len(graph.column_counts) > MOST_STEPS else ""
    sums = [
        ("column counts", counts + more),
        ("fill", str(graph.fill)),
        ("flops", f"{graph.flops} (CHOLMOD's own count: {number(graph.cholmod_flops)})"),
        ("nonzeros", f"{graph.nnz} of the matrix, {graph.nnz_factor} of its factor L"),
        ("", CONVENTION),
        ("tree height", str(graph.tree_height)),
    ]
    missing = "Too many neighbours to record the steps of the elimination."
    return Report(
        command="inspect",
        headline=[
            f"{sizes}, eliminated in {graph.ordering} order: fill {graph.fill}, {graph.nnz_factor} "
            f"nonzeros of the factor L, {graph.flops} flops, tree height {graph.tree_height}."
        ],
        sections=[
            Section(tables=[_steps(graph)], is_detail=len(graph.steps) > SHORT)
            if graph.steps
            else Section(text=[missing]),
            Section(facts=[("graph", shown(path)), *sums], is_detail=True),
        ],
        data={
            "graph": path,
            **fields(graph),
            "nonzeros": CONVENTION,
            "wall_time": {"total": wall_time},
        },
    )


def _steps(graph: GraphInspection) -> Table:
    names = graph.names
    columns = (
        Column("eliminated", lambda step: names[step.variable]),
        Column("neighbours", lambda step: _members([names[k] for k in step.neighbours])),
        Column("fill", lambda step: _members([f"{names[a]}-{names[b]}" for a, b in step.fill])),
        Column("flops", "flops"),
        Column("fill so far", "total_fill"),
        Column("so far", "total_flops"),
    )
    cells = Table(columns, graph.steps[:MOST_STEPS]).cells()
    if len(graph.steps) > MOST_STEPS:
        cells.append((f"... {len(graph.steps) - MOST_STEPS} more", "", "", "", "", ""))
    return Table.of([column.title for column in columns], cells, left=3)


def _members(members: Sequence[str]) -> str:
    more = f" +{len(members) - MOST_MEMBERS}" if len(members) > MOST_MEMBERS else ""
    return " ".join(members[:MOST_MEMBERS]) + more
