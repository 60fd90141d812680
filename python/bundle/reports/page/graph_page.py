"""Pages of a graph before a solve: cost and steps of each elimination order."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import bundle._core as _core
from bundle.base.paths import as_path
from bundle.base.words import amount, few, span
from bundle.figures.cost_figures import bar_figure, column_figure
from bundle.figures.matplotlib.matrix_pattern import MatrixPattern
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.inspection.elimination_costs import ORDERINGS, FactorGraphInspection
from bundle.planning.inspection.graph_inspection import inspect_graph
from bundle.planning.inspection.pose_graph_time import free_pattern
from bundle.reports.page.elimination_player import (
    MOST_VARIABLES,
    elimination_data,
    elimination_section,
    order_name,
)
from bundle.reports.page.graph_report import structure_section
from bundle.reports.page.page import orderings, tag, write_page
from bundle.reports.page.table import CONVENTION, rendered
from bundle.reports.sections import Column, Section, Table
from bundle.reports.terminal.inputs import contents_of

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
    stepped = f"Only graphs with up to {MOST_VARIABLES} variables are drawn step by step."
    best_row = best if len(graphs) > 1 else None
    table = Table(ORDERS, graphs, left=2, best=best_row, legend=CONVENTION)
    figures = [bar_figure("flops", "Flops, on a log scale", flops, amount), column_figure(profiles)]
    sections: list[Section | str] = [
        Section(text=[size], tables=[table]),
        Section(title="Elimination step by step", text=[] if steppable else [stepped]),
        elimination_section(steppable) if steppable else "",
        Section(title="Orders compared", figures=figures),
        Section(title="Matrix and factor"),
        orderings(pattern, {order_name(graph): graph.order for graph in graphs}, "matrix"),
    ]
    data = {"elimination": elimination_data(steppable)} if steppable else None
    least = f"{order_name(graphs[best])} needs {graphs[best].flops:,} flops"
    title = "Elimination of a graph"
    write_page(Path(path), title, rendered(sections), data, headline=f"{title}: {least}")


ORDERS = (
    Column("order", order_name),
    Column("eliminated in order", lambda graph: few([graph.names[k] for k in graph.order], 40)),
    Column("fill edges", "fill", amount),
    Column("nonzeros of the matrix", "nnz", amount),
    Column("nonzeros of L", "nnz_factor", amount),
    Column("flops", "flops", amount),
    Column("CHOLMOD's flops", "cholmod_flops", amount),
    Column("largest column count", lambda graph: amount(max(graph.column_counts, default=0))),
    Column("height of the tree", "tree_height", amount),
)


# Page of a pose graph before a solve: cost of each elimination order, matrices, the elimination.
#
# A small graph can be stepped through in every order; a matrix of many poses is not drawn, because
# its factor would take longer than a solve.

STEPPED = ("natural", "reverse", "minimum_degree", *ORDERINGS[1:])

MOST_DRAWN = 20_000  # largest number of poses whose matrix and factors are drawn


def write_graph_structure(
    found: FactorGraphInspection, path: str | os.PathLike[str], graph: PoseGraph, *, name: str = ""
) -> None:
    """Write the page of an inspected pose graph."""
    pattern = free_pattern(graph)
    count = len(pattern.sizes)
    held, _, _ = _core.hold_poses(graph)
    names = [graph.pose_name(pose) for pose in np.flatnonzero(~held).tolist()]
    times = {
        cost.ordering: cost.time_per_step_in_seconds
        for cost in found.costs
        if np.isfinite(cost.time_per_step_in_seconds)
    }
    flops = {cost.ordering: float(cost.flops) for cost in found.costs}
    words = f"{contents_of(graph)}; {count} free poses of {graph.tangent_size} unknowns."
    sections: list[Section | str] = [
        tag("p", escape(words), class_="quiet"),
        structure_section(found),
        Section(
            title="Cost of an order",
            figures=[
                bar_figure("time", "Predicted time of a step, on a log scale", times, span),
                bar_figure("flops", "Flops of the factorisation, on a log scale", flops, amount),
            ],
        ),
    ]
    if count <= MOST_DRAWN:
        orders = {order: _core.order_blocks(*pattern, order) for order in ORDERINGS}
        sections += [
            Section(title="Matrix and factor", text=["Fill is orange."]),
            orderings(MatrixPattern.of(pattern), orders, "matrix"),
        ]
    data = None
    if count <= MOST_VARIABLES:
        size, edges = graph.tangent_size, pattern.edges
        graphs = [
            inspect_graph(edges, count, order, names=names, block_size=size, record_steps=True)
            for order in STEPPED
        ]
        hint = "Choose an order, and eliminate pose by pose; a new edge is fill."
        sections += [
            Section(title="Elimination step by step", text=[hint]),
            elimination_section(graphs),
        ]
        data = {"elimination": elimination_data(graphs)}
    short = "/".join(Path(name).parts[-2:]) or "A pose graph"
    write_page(
        as_path(path),
        f"Structure of {name}" if name else "Structure of a pose graph",
        rendered(sections),
        data,
        headline=f"{short}: {found.recommendation}",
    )
