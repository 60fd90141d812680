"""The page of a problem: what each way to solve it will cost, and why."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape
from pathlib import Path

from bundle.html.charts import bars
from bundle.html.elimination import MOST_VARIABLES, elimination_data, elimination_section
from bundle.html.graph import column_counts, write_graph
from bundle.html.matrices import covisibility, matrix, orderings
from bundle.html.numbers import amount, amount_if_any, seconds
from bundle.html.page import tag, write_page
from bundle.html.subgraph import image_graph
from bundle.html.table import Notes, convention, table
from bundle.inspection import GraphInspection, Inspection, MethodInspection, inspect_graph
from bundle.memory_sizes import format_size
from bundle.options import SolveOptions
from bundle.pictures.covisibility import covisibility_graph
from bundle.pictures.problem_patterns import (
    ORDERINGS,
    information_pattern,
    order_blocks,
    reduced_pattern,
)
from bundle.problem import Problem

__all__ = ["write_inspection"]

STEPPED = ("natural", "minimum_degree")
MOST_EDGES = 1500


def write_inspection(
    inspection: Inspection | GraphInspection | Sequence[GraphInspection],
    path: str | os.PathLike[str],
    problem: Problem | None = None,
    options: SolveOptions | None = None,
    *,
    name: str = "",
) -> None:
    """Write an inspection as one HTML file that needs nothing else.

    Args:
        inspection: of a problem, or of a graph. One graph that is small enough to be stepped
            through is compared to itself in natural order and by minimum degree; several are the
            same graph under the orders to compare.
        path: of the file, which appears whole or not at all.
        problem: the one inspected, whose matrices and co-visibility are drawn; a page without it
            has tables and bars alone. Nothing for a graph.
        options: with which it was inspected: they decide what is refined.
        name: of the problem, for the title of its page.

    Raises:
        InputError: the path is a folder, or its parent is none.
        OSError: the file cannot be written.
    """
    if isinstance(inspection, Inspection):
        title = f"What solving {name} costs" if name else "What solving costs"
        _write_problem(inspection, Path(path), title, problem, options or SolveOptions())
    elif isinstance(inspection, GraphInspection):
        write_graph(_with_rivals(inspection), path)
    else:
        write_graph(inspection, path)


def _with_rivals(graph: GraphInspection) -> list[GraphInspection]:
    """Return a graph under its own order first, then under others that say what it is worth."""
    if graph.num_variables > MOST_VARIABLES:
        return [graph]
    rivals = [
        inspect_graph(
            graph.edges,
            graph.num_variables,
            ordering,
            names=graph.names,
            block_size=graph.block_sizes,
        )
        for ordering in STEPPED
        if ordering != graph.ordering
    ]
    return [graph, *(rival for rival in rivals if rival.order != graph.order)]


def _write_problem(
    inspection: Inspection,
    path: Path,
    title: str,
    problem: Problem | None,
    options: SolveOptions,
) -> None:
    sections = [
        _scope(inspection),
        tag("div", tag("p", escape(inspection.recommendation)), class_="recommended"),
        tag("h2", "Methods"),
        _methods(inspection),
        tag("h2", "What a step costs"),
        _costs(inspection),
    ]
    graphs: list[GraphInspection] = []
    if problem is not None:
        names, edges = image_graph(problem)
        graphs = [
            inspect_graph(edges, len(names), ordering=ordering, names=names)
            for ordering in STEPPED
            if edges
        ]
        sections += _matrices(problem, options)
        sections += [
            tag("h2", "Co-visibility"),
            tag("p", "Images where they stand; the darker an edge, the more points its images "
                "share. Each edge is a block of S.", class_="quiet"),
            covisibility(covisibility_graph(problem, MOST_EDGES)),
        ]  # fmt: skip
    if graphs:
        words = (
            f"{graphs[0].num_variables} images of the problem, eliminated one by one; an edge "
            "joins images that share points, and each image counts as a single unknown."
        )
        sections += [
            tag("h2", "Elimination step by step"),
            tag("p", words, class_="quiet"),
            elimination_section(graphs),
        ]
    data = {"elimination": elimination_data(graphs)} if graphs else None
    write_page(path, title, sections, data)


def _scope(inspection: Inspection) -> str:
    words = (
        f"{inspection.num_observations:,} observations, {inspection.num_free_points:,} points and "
        f"{inspection.num_camera_blocks:,} blocks of {inspection.num_camera_columns:,} unknowns on "
        f"the camera side; S is {inspection.reduced_density:.2%} full. Times are for "
        f"{inspection.num_threads} threads of this machine, which has "
        f"{format_size(inspection.available_memory_in_bytes)} free."
    )
    return tag("p", words, class_="quiet")


def _label(method: MethodInspection) -> str:
    return f"{method.backend.lower()} {method.name}".strip()


def _methods(inspection: Inspection) -> str:
    head = [
        "method", "time per step", "memory", "fits", "nonzeros of S", "nonzeros of L", "fill edges",
        "flops", "CHOLMOD's flops", "height of the tree", "unknowns", "nonzeros of J",
        "nonzeros of the information matrix", "note",
    ]  # fmt: skip
    notes = Notes()
    rows = []
    for method in inspection.methods:
        has_factor = method.nnz_factor > 0
        counts = (
            method.nnz_factor,
            method.fill,
            method.flops,
            method.cholmod_flops,
            method.tree_height,
        )
        rows.append([
            _label(method),
            seconds(method.time_per_step_in_seconds),
            format_size(method.memory_in_bytes),
            "yes" if method.fits_in_memory else "NO",
            amount_if_any(method.nnz_reduced),
            *(amount(count) if has_factor else "-" for count in counts),
            amount(method.num_unknowns),
            amount(method.nnz_jacobian),
            amount(method.nnz_information),
            notes.refer(method.note),
        ])  # fmt: skip
    best = inspection.recommended if inspection.recommended >= 0 else None
    unfit = [_label(method) for method in inspection.methods if not method.fits_in_memory]
    warning = f"Does not fit in memory: {', '.join(unfit)}."
    return "".join(
        [
            table(head, rows, best=best),
            convention(),
            notes.listed(),
            tag("p", escape(warning), class_="warn") if unfit else "",
        ]
    )


def _costs(inspection: Inspection) -> str:
    methods = inspection.methods
    unfit = [method for method in methods if not method.fits_in_memory]
    flops = {method.name: method.flops for method in methods if method.flops > 0}
    times = {_label(method): method.time_per_step_in_seconds for method in methods}
    profiles = {
        method.name: method.column_count_profile
        for method in methods
        if method.linear_solver_type.endswith("_SCHUR")
        and method.ordering != "cameras_first"
        and method.column_count_profile
    }
    charts = [
        tag("figure", tag("h3", "Flops of the factorisation, on a log scale"),
            bars(flops, impossible=[method.name for method in unfit])),
        tag("figure", tag("h3", "Time of a step, on a log scale"),
            bars(times, impossible=[_label(method) for method in unfit], show=seconds)),
        column_counts(profiles) if profiles else "",
    ]  # fmt: skip
    return tag("div", *charts, class_="grid")


def _matrices(problem: Problem, options: SolveOptions) -> list[str]:
    """Return the sections of S and L under each order, and of the arrowhead."""
    reduced = reduced_pattern(problem, options)
    arrowhead = information_pattern(problem, options)
    words = (
        "The darker a pixel, the more of its cells are nonzero, on a log scale: a lone nonzero is "
        "still visible. Fill is orange."
    )
    first = tag("div", matrix(arrowhead, "information matrix, points first"), class_="grid spies")
    if reduced.num_blocks == 0:
        return [tag("h2", "The information matrix"), first]
    orders = {name: order_blocks(reduced, name) for name in ORDERINGS}
    return [
        tag("h2", "S and its factor under each order"),
        tag("p", words, class_="quiet"),
        orderings(reduced, orders),
        tag("h2", "The information matrix"),
        tag("p", "An arrowhead: eliminating the points leaves S.", class_="quiet"),
        first,
    ]
