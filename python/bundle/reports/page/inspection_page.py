"""Page of a problem: predicted cost of each method and of several processes, with reasons."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from pathlib import Path

import numpy as np

from bundle.base.arrays import check_type
from bundle.base.paths import as_path
from bundle.base.words import amount, format_size, plural, span
from bundle.errors import InputError
from bundle.figures.cost_figures import bar_figure, column_figure
from bundle.figures.marks import Figure, Line, logarithmic
from bundle.figures.matplotlib.matrix_pattern import (
    ORDERINGS,
    information_pattern,
    order_blocks,
    reduced_pattern,
)
from bundle.figures.structure_figures import covisibility_figure, covisibility_graph
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.comparison.recommendation import recommended_command
from bundle.planning.inspection.graph_inspection import GraphInspection, inspect_graph
from bundle.planning.inspection.inspection_result import Inspection, MethodInspection
from bundle.planning.inspection.rank_prediction import NETWORK, RankPrediction
from bundle.reports.page.elimination_player import (
    MOST_VARIABLES,
    elimination_data,
    elimination_section,
    image_graph,
)
from bundle.reports.page.graph_page import write_graph
from bundle.reports.page.page import command_box, matrix, orderings, tag, write_page
from bundle.reports.page.table import CONVENTION, rendered
from bundle.reports.sections import Column, Section, Table
from bundle.reports.terminal.inspect import factor_table, rank_sections, size_facts

STEPPED = ("natural", "minimum_degree")
MOST_EDGES = 1500
# Number of methods that are shown; the other methods are folded away.
ROWS_SHOWN = 5
FULL = 0.95  # share of nonzeros in S from which its drawings under all orders look the same


def write_inspection(
    inspection: Inspection | GraphInspection | Sequence[GraphInspection],
    path: str | os.PathLike[str],
    problem: Problem | None = None,
    options: SolveOptions | None = None,
    *,
    name: str = "",
    ranks: Sequence[RankPrediction] = (),
    network: tuple[float, float] = NETWORK,
) -> None:
    """Write an inspection as one self-contained HTML file.

    Args:
        inspection: inspection of a problem or of a graph. A single small graph is compared with
            itself in natural order and under minimum degree. Several inspections
            must be of one graph, under the orders to compare.
        path: path of the file. A failed write leaves no partial file.
        problem: the inspected problem; its matrices and co-visibility graph are drawn. Without
            it, the page has only tables and bars. None for a graph.
        options: options of the inspection; they decide which parameters are refined.
        name: name of the problem, for the title.
        ranks: predictions of ``predict_ranks`` for several processes; empty for a graph.
        network: network of these predictions: gigabits per second, latency in microseconds.

    Raises:
        InputError: the path is a folder, or a path above it is not a folder.
        OSError: the file cannot be written.
    """
    path = as_path(path)
    if problem is not None:
        check_type("problem", problem, Problem)
    options = SolveOptions.of(options, {}, "options")
    if isinstance(inspection, Inspection):
        title = f"Solver cost of {name}" if name else "Solver cost"
        rows = sorted(ranks, key=lambda row: row.num_processes)
        figures = [_time(rows), _memory(rows)] if len(rows) > 1 else []
        processes = [replace(section, figures=figures) for section in rank_sections(rows, network)]
        _write_problem(inspection, path, title, problem, options, name, processes)
    elif isinstance(inspection, GraphInspection):
        write_graph(_with_rivals(inspection), path)
    else:
        listed = isinstance(inspection, list | tuple)
        graphs: list[GraphInspection] = [*inspection] if listed else [inspection]  # type: ignore[list-item]
        for graph in graphs:
            check_type("inspection", graph, GraphInspection)
        if not graphs:
            raise InputError("inspection: expected at least one GraphInspection, found 0")
        write_graph(graphs, path)


def _with_rivals(graph: GraphInspection) -> list[GraphInspection]:
    """Return a graph under its own order first, then under other orders for comparison."""
    if graph.num_variables > MOST_VARIABLES:
        return [graph]
    count, names, sizes = graph.num_variables, graph.names, graph.block_sizes
    rivals = [
        inspect_graph(graph.edges, count, ordering, names=names, block_size=sizes)
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
    name: str,
    processes: Sequence[Section],
) -> None:
    methods = _ranked(inspection)
    factors = replace(factor_table(methods), most=ROWS_SHOWN, legend=CONVENTION)
    free = format_size(inspection.available_memory_in_bytes)
    machine = f"{plural(inspection.num_threads, 'thread')}, {free} of free memory"
    sections: list[Section | str] = [
        _recommendation(inspection, options, name),
        Section(facts=[("input", name), *size_facts(inspection), ("machine", machine)]),
        *_methods(inspection, methods),
        Section(title="Cost of a step", figures=_costs(methods)),
        *processes,
        *([Section(title="Factors", tables=[factors])] if factors.rows else []),
    ]
    graphs: list[GraphInspection] = []
    if problem is not None:
        names, edges = image_graph(problem)
        graphs = [
            inspect_graph(edges, len(names), ordering=ordering, names=names)
            for ordering in STEPPED
            if edges
        ]
        words = (
            "Images where they stand; the stronger an edge, the more points its images share. "
            "Each edge is a block of S."
        )
        drawn = covisibility_figure(covisibility_graph(problem, MOST_EDGES))
        sections += _matrices(problem, options, inspection.reduced_density)
        sections.append(Section(title="Co-visibility", text=[words], figures=[drawn]))
    if graphs:
        words = (
            f"{graphs[0].num_variables} images of the problem, eliminated one by one; an edge "
            "joins images that share points, and each image counts as a single unknown."
        )
        sections.append(Section(title="Elimination step by step", text=[words]))
        sections.append(elimination_section(graphs))
    data = {"elimination": elimination_data(graphs)} if graphs else None
    write_page(path, title, rendered(sections), data, headline=_headline(inspection))


def _ranked(inspection: Inspection) -> list[MethodInspection]:
    """Return the selectable methods that fit into memory, then the others; fastest first."""
    methods = inspection.methods
    best = inspection.recommended

    def rank(index: int) -> tuple[bool, bool, bool, float]:
        method = methods[index]
        time = method.time_per_step_in_seconds
        return index != best, not method.fits_in_memory, not method.is_taken, time

    return [methods[index] for index in sorted(range(len(methods)), key=rank)]


def _headline(inspection: Inspection) -> str:
    if inspection.recommended < 0:
        free = format_size(inspection.available_memory_in_bytes)
        return f"No method fits into the free memory ({free})"
    best = inspection.methods[inspection.recommended]
    time = span(best.time_per_step_in_seconds)
    return f"Use {_label(best)}: {time} per step, {format_size(best.memory_in_bytes)}"


def _recommendation(inspection: Inspection, options: SolveOptions, name: str) -> str:
    command = recommended_command(inspection, options, name or "INPUT")
    lines = [command_box(command)] if command else []
    return tag("div", *lines, tag("p", escape(inspection.recommendation)), class_="recommended")


def _label(method: MethodInspection) -> str:
    return f"{method.backend.lower()} {method.name}".strip()


def _methods(inspection: Inspection, methods: Sequence[MethodInspection]) -> list[Section | str]:
    notes = [*dict.fromkeys(method.note for method in methods if method.note)]
    columns = (
        Column("method", _label),
        Column("time per step", "time_per_step_in_seconds", span),
        Column("memory", "memory_in_bytes", format_size),
        Column("fits", "fits_in_memory", lambda fits: "yes" if fits else "NO"),
        Column("note", "note", lambda note: str(notes.index(note) + 1) if note else ""),
    )
    unfit = [_label(method) for method in methods if not method.fits_in_memory]
    best = 0 if inspection.recommended >= 0 else None
    shown = Section(
        title="Methods, the fastest first",
        notes=[f"Does not fit in memory: {', '.join(unfit)}."] if unfit else [],
        is_warning=True,
        tables=[Table(columns, methods, most=ROWS_SHOWN, best=best)],
    )
    listed = tag("ol", *(tag("li", escape(note)) for note in notes), class_="quiet")
    return [shown, listed if notes else ""]


def _costs(methods: Sequence[MethodInspection]) -> list[Figure]:
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
    return [
        bar_figure(
            "time_per_step", "Time per step, on a log scale", times, span,
            [_label(method) for method in unfit], ROWS_SHOWN,
        ),
        bar_figure(
            "flops", "Flops of the factorisation, on a log scale", flops, amount,
            [method.name for method in unfit], ROWS_SHOWN,
        ),
        *([column_figure(profiles)] if profiles else []),
    ]  # fmt: skip


def _matrices(problem: Problem, options: SolveOptions, density: float) -> list[Section | str]:
    """Return the sections on S and L under each order, and on the arrowhead matrix."""
    reduced = reduced_pattern(problem, options)
    arrowhead = information_pattern(problem, options)
    words = (
        "The more a pixel stands out, the more of its cells are nonzero, on a log scale: a lone "
        "nonzero is still visible. Fill is orange."
    )
    first = tag("div", matrix(arrowhead, "information matrix, points first"), class_="grid spies")
    arrow = "An arrowhead: eliminating the points leaves S."
    if reduced.num_blocks == 0:
        return [Section(title="The information matrix"), first]
    count, title = len(ORDERINGS), "S and its factor under each order"
    if density >= FULL:
        count, title = 1, f"S and its factor, {100 * density:.3g} % full in any order"
    orders = {name: order_blocks(reduced, name) for name in ORDERINGS[:count]}
    return [
        Section(title=title, text=[words]),
        orderings(reduced, orders),
        Section(title="The information matrix", text=[arrow]),
        first,
    ]


def _time(rows: Sequence[RankPrediction]) -> Figure:
    parts = {
        "a step": [row.time_per_step_in_seconds for row in rows],
        "points, divided": [row.points_time_per_step_in_seconds for row in rows],
        "the first process alone": [row.first_time_per_step_in_seconds for row in rows],
        "messages": [row.network_time_per_step_in_seconds or math.nan for row in rows],
        "a step of one process / N": [
            row.efficiency * row.time_per_step_in_seconds for row in rows
        ],
    }
    return _figure("Time of a step, on a log scale", parts, rows, "seconds")


def _memory(rows: Sequence[RankPrediction]) -> Figure:
    others = [
        row.memory_of_others_in_bytes / 1e9 if row.num_processes > 1 else math.nan for row in rows
    ]
    first = [row.memory_of_first_in_bytes / 1e9 for row in rows]
    parts = {"the first process": first, "each of the others": others}
    return _figure("Peak memory, on a log scale", parts, rows, "GB")


def _figure(
    title: str, parts: dict[str, list[float]], rows: Sequence[RankPrediction], unit: str
) -> Figure:
    counts = [float(row.num_processes) for row in rows]
    lines = tuple(
        Line(name, np.array(counts), np.array(values), colour=k, dash=k)
        for k, (name, values) in enumerate(parts.items())
    )
    heights = [value for values in parts.values() for value in values]
    return Figure(
        name="processes", title=title, marks=lines, x=logarithmic(counts, "processes"),
        y=logarithmic(heights, unit),
    )  # fmt: skip
