"""Page of a graph: cost and steps of each elimination order."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bundle.base.words import amount
from bundle.figures.cost_figures import bar_figure, column_figure
from bundle.figures.matplotlib.matrix_pattern import MatrixPattern
from bundle.reports.page.elimination_player import (
    MOST_VARIABLES,
    elimination_data,
    elimination_section,
    order_name,
)
from bundle.reports.page.matrices import orderings
from bundle.reports.page.page import write_page
from bundle.reports.page.section_markup import rendered
from bundle.reports.page.table import CONVENTION
from bundle.reports.sections import Section, Table

if TYPE_CHECKING:
    from bundle.planning.inspection.graph_inspection import GraphInspection


def write_graph(graphs: Sequence[GraphInspection], path: str | os.PathLike[str]) -> None:
    """Write the page of a graph under one or several elimination orders."""
    first = graphs[0]
    best = min(range(len(graphs)), key=lambda index: graphs[index].flops)
    size = f"{first.num_variables:,} variables, {len(first.edges):,} edges"
    flops = {f"order {order_name(graph)}": float(graph.flops) for graph in graphs}
    profiles = {f"order {order_name(graph)}": graph.column_counts for graph in graphs}
    pattern = MatrixPattern.of(first.pattern())
    steppable = [
        graph
        for graph in graphs
        if graph.num_variables <= MOST_VARIABLES and len(graph.steps) == graph.num_variables
    ]
    stepped = f"Graphs are drawn step by step up to {MOST_VARIABLES} variables."
    figures = [bar_figure("flops", "Flops, on a log scale", flops, amount), column_figure(profiles)]
    sections: list[Section | str] = [
        Section(text=[size], tables=[_orders(graphs, best)]),
        Section(title="Elimination step by step", text=[] if steppable else [stepped]),
        elimination_section(steppable) if steppable else "",
        Section(title="Orders compared", figures=figures),
        Section(title="Matrix and factor"),
        orderings(pattern, {order_name(graph): graph.order for graph in graphs}, "matrix"),
    ]
    data = {"elimination": elimination_data(steppable)} if steppable else None
    write_page(Path(path), "Elimination of a graph", rendered(sections), data)


def _orders(graphs: Sequence[GraphInspection], best: int) -> Table:
    head = [
        "order", "eliminated in order", "fill edges", "nonzeros of the matrix", "nonzeros of L",
        "flops", "CHOLMOD's flops", "largest column count", "height of the tree",
    ]  # fmt: skip
    rows = []
    for graph in graphs:
        shown = [graph.names[variable] for variable in graph.order[:40]]
        rows.append([
            order_name(graph),
            ", ".join(shown) + (", ..." if len(graph.order) > len(shown) else ""),
            amount(graph.fill),
            amount(graph.nnz),
            amount(graph.nnz_factor),
            amount(graph.flops),
            amount(graph.cholmod_flops),
            amount(max(graph.column_counts, default=0)),
            amount(graph.tree_height),
        ])  # fmt: skip
    best_row = best if len(graphs) > 1 else None
    return Table.of(head, rows, left=2, best=best_row, legend=CONVENTION)
