"""Reports of `bundle inspect`: a problem, numbers (`--shape`), a small graph (`--graph`)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bundle.base.words import amount, duration, format_size, number, plural
from bundle.errors import shown
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.comparison.recommendation import recommended_command
from bundle.planning.inspection.elimination_costs import CONVENTION
from bundle.planning.inspection.graph_inspection import GraphInspection
from bundle.planning.inspection.inspection_result import Inspection, MethodInspection
from bundle.planning.inspection.peak_memory import ON_DISK, ProblemNeeds, SchurCounts
from bundle.planning.inspection.rank_prediction import RankPrediction, find_rank_limit
from bundle.reports.sections import Column, Report, Section, Table, fields
from bundle.reports.terminal.inputs import about_input, input_facts
from bundle.solving.slices.scratch_size import RESIDENT_BYTES, scratch_bytes

_CLEARLY_SLOWER = 1.25


FACTORS = (
    Column("factor L", "name"),
    Column("nonzeros of S", lambda one: amount(one.nnz_reduced or math.nan), is_page_only=True),
    Column("nonzeros", "nnz_factor", number),
    Column("fill", "fill", number),
    Column("flops", "flops", number),
    Column("CHOLMOD's", "cholmod_flops", number),
    Column("height", "tree_height"),
    Column("fullest", lambda method: max(method.column_count_profile, default=0)),
)


def inspected(
    path: str,
    problem: Problem,
    inspection: Inspection,
    options: SolveOptions,
    names: Iterable[str],
    ranks: Sequence[RankPrediction],
    network: tuple[float, float],
    wall_time: float,
) -> Report:
    """Return the report; ``names`` are the options that affect an inspection."""
    facts = [*input_facts(path, problem, rigs=True), *size_facts(inspection), ("", CONVENTION)]
    command = recommended_command(inspection, options, shown(path))
    return Report(
        command="inspect",
        input=about_input(path, problem),
        headline=_headline(inspection),
        sections=[
            *([Section(command=command)] if command else []),
            *rank_sections(ranks, network),
            Section(facts=facts, is_detail=True),
            Section(tables=[factor_table(inspection.methods)], is_detail=True),
            Section(tables=[_costs(inspection)], is_detail=True),
            Section(notes=_remarks(inspection), is_detail=True),
        ],
        data={
            "options": {name: getattr(options, name) for name in names},
            **fields(inspection),
            "recommended_command": recommended_command(inspection, options, path),
            "nonzeros": CONVENTION,
            "wall_time": {"total": wall_time},
            **_rank_data(ranks, network),
        },
    )


def _headline(inspection: Inspection) -> list[str]:
    if inspection.recommended < 0:
        return [inspection.recommendation, *_out_of_core(inspection)]
    return [f"Recommended: {inspection.recommendation}", _cost_of(inspection, _best(inspection))]


def _cost_of(inspection: Inspection, method: MethodInspection) -> str:
    return (
        f"Predicted: {duration(method.time_per_step_in_seconds)} per step and "
        f"{format_size(method.memory_in_bytes)} on {plural(inspection.num_threads, 'thread')}, for "
        f"{plural(method.num_unknowns, 'unknown', grouped=True)}."
    )


def predicted(inspection: Inspection, options: SolveOptions, adjustments: int) -> list[str]:
    """Return the predicted cost of adjustments with the solver of the options, in sentences."""
    backend, solver = options.backend.upper(), options.linear_solver_type.upper()
    backend = backend if backend != "AUTO" else "FUSED" if inspection.auto_choice else "CERES"
    solver = inspection.auto_choice if (solver, backend) == ("AUTO", "FUSED") else solver
    methods = [
        method
        for method in inspection.methods
        if method.backend == backend and solver in ("AUTO", method.linear_solver_type)
    ]
    if not methods:
        return ["The cost of this solver is not predicted."]
    method = min(methods, key=lambda one: one.time_per_step_in_seconds)
    steps = adjustments * options.max_num_iterations
    longest = duration(steps * method.time_per_step_in_seconds)
    fits = "" if method.fits_in_memory else " This does not fit into the free memory."
    return [
        f"{_cost_of(inspection, method)}{fits}",
        f"At most {plural(steps, 'step')}: {longest}, in addition to reading and writing.",
    ]


def size_facts(inspection: Inspection) -> list[tuple[str, str]]:
    """Return the numbers of unknowns and of nonzeros."""
    method = inspection.methods[0]
    full = f"{100.0 * inspection.reduced_density:.3g} % full"
    reduced = f", S {number(method.nnz_reduced)} ({full})" if method.nnz_reduced else ""
    unknowns = (
        f"{method.num_unknowns}: {plural(inspection.num_free_points, 'point')}, and "
        f"{inspection.num_camera_columns} in {inspection.num_camera_blocks} blocks of cameras"
    )
    nonzeros = (
        f"J {number(method.nnz_jacobian)}, information matrix {number(method.nnz_information)}"
        f"{reduced}"
    )
    return [("unknowns", unknowns), ("nonzeros", nonzeros)]


def factor_table(methods: Sequence[MethodInspection]) -> Table:
    """Return a row for each factor, whatever backends compute it."""
    factors = {method.name: method for method in methods if method.nnz_factor}
    return Table(FACTORS, [*factors.values()])


def _costs(inspection: Inspection) -> Table:
    names = dict.fromkeys(method.name for method in inspection.methods)
    by_key = {(method.name, method.backend): method for method in inspection.methods}
    rows = []
    for name in names:
        ours = by_key.get((name, "FUSED")) or by_key.get((name, ""))
        theirs = by_key.get((name, "CERES"))
        chosen = inspection.recommended >= 0 and name == _best(inspection).name
        rows.append((f"{name} <" if chosen else name, *_cost(ours), *_cost(theirs)))
    head = ("method", "fused: memory", "fused: per step", "Ceres: memory", "Ceres: per step")
    return Table.of(head, rows)


def _cost(method: MethodInspection | None) -> tuple[str, str]:
    if method is None:
        return "-", "-"
    memory = format_size(method.memory_in_bytes)
    if not method.fits_in_memory:
        return f"{memory} !", "-"
    time = duration(method.time_per_step_in_seconds)
    return memory, time if method.is_taken else f"({time})"


def _out_of_core(inspection: Inspection) -> list[str]:
    """Return the needs of the method with the least memory if its large arrays are on a disk."""
    fused = [method for method in inspection.methods if method.backend == "FUSED"]
    if not fused:
        return []
    needs = [
        sum(bytes for name, bytes in method.memory_terms.items() if name not in ON_DISK)
        for method in fused
    ]
    memory = min(needs) + RESIDENT_BYTES
    if memory > inspection.available_memory_in_bytes:
        return []
    disk = scratch_bytes(inspection.num_observations, inspection.num_free_points)
    return [
        f"`bundle refine INPUT -o OUTPUT --out-of-core DIR` needs {format_size(disk)} of disk and "
        f"{format_size(memory)} of memory."
    ]


def _best(inspection: Inspection) -> MethodInspection:
    return inspection.methods[inspection.recommended]


def _remarks(inspection: Inspection) -> list[str]:
    free = format_size(inspection.available_memory_in_bytes)
    remarks = [
        "flops: sum of c^2 + 3 c over the columns of L, c being entries below the diagonal. "
        "CHOLMOD's: sum of (c + 1)^2. fill: pairs of blocks. height: of the elimination tree, in "
        "blocks. fullest: entries below the diagonal of the fullest column of L.",
        f"Times are for {plural(inspection.num_threads, 'thread')}, from this machine's measured "
        f"rates. Memory is the peak beyond the problem, of {free} free.",
    ]
    if any(not method.fits_in_memory for method in inspection.methods):
        remarks.append("! does not fit into free memory.")
        remarks += _out_of_core(inspection)
    if any(not method.is_taken for method in inspection.methods):
        remarks.append(
            "(in brackets): for comparison only. The fused backend uses the order of natural, AMD "
            "and METIS with the fewest flops, Ceres uses AMD."
        )
    remarks += _disagreement(inspection)
    by_note: dict[str, dict[str, str]] = {}
    for method in inspection.methods:
        if method.note and method.is_taken:
            by_note.setdefault(method.note, {})[method.name] = method.linear_solver_type
    for note, names in by_note.items():
        solvers = dict.fromkeys(names.values())
        whose = solvers if len(names) > 2 and len(solvers) == 1 else names  # a common solver
        remarks.append(f"{', '.join(whose)}: {note}.")
    return remarks


def _disagreement(inspection: Inspection) -> list[str]:
    """Return a remark if `--solver auto` selects a method that is predicted to be much slower."""
    auto = [
        method
        for method in inspection.methods
        if method.is_taken
        and method.backend == "FUSED"
        and method.linear_solver_type == inspection.auto_choice
    ]
    if not auto or inspection.recommended < 0:
        return []
    best = _best(inspection).time_per_step_in_seconds
    taken = min(method.time_per_step_in_seconds for method in auto)
    if taken <= _CLEARLY_SLOWER * best:
        return []
    return [
        f"`--solver auto` would select {inspection.auto_choice}, from the rates of a reference "
        "machine. `bundle compare` measures which is faster."
    ]


RANKS = (
    Column("processes", "num_processes"),
    Column("per step", "time_per_step_in_seconds", duration),
    Column("messages", lambda row: _sent(row, duration(row.network_time_per_step_in_seconds))),
    Column("efficiency", "efficiency", lambda share: f"{100 * share:.0f} %"),
    Column("sent", lambda row: _sent(row, format_size(row.bytes_per_step))),
    Column("first: memory", "memory_of_first_in_bytes", format_size),
    Column("others", lambda row: _sent(row, format_size(row.memory_of_others_in_bytes))),
)


def _sent(row: RankPrediction, cell: str) -> str:
    return cell if row.bytes_per_step else "-"


def rank_sections(ranks: Sequence[RankPrediction], network: tuple[float, float]) -> list[Section]:
    """Return the predicted cost of several processes; empty if not requested."""
    if not ranks:
        return []
    rate, latency = network
    limit = find_rank_limit(ranks)
    words = (
        f"Processes of mpirun, {ranks[0].method}, {rate:g} Gbit/s and {latency:g} "
        "microseconds between them; the first one solves the reduced system alone. Memory "
        "is that of whole processes, which read slices of BAL files and binary models."
    )
    notes = [*([] if limit is None else [limit.message]), words]
    counts = [row.num_processes for row in ranks]
    best = counts.index(limit.num_processes) if limit and limit.num_processes in counts else None
    made = Table(RANKS, ranks, best=best)
    return [Section(title="Several processes", tables=[made], notes=notes)]


def _rank_data(ranks: Sequence[RankPrediction], network: tuple[float, float]) -> dict[str, Any]:
    if not ranks:
        return {}
    rate, latency = network
    return {
        "network": {"gbit_per_second": rate, "latency_in_microseconds": latency},
        "ranks": ranks,
        "rank_limit": find_rank_limit(ranks),
    }


def inspected_shape(
    shape: Mapping[str, int], counts: SchurCounts, needs: ProblemNeeds, wall_time: float
) -> Report:
    """Return the report on num_cameras, num_points and track_length in this order."""
    cameras, points, track = shape.values()
    terms = [
        ("invert V_p", "27 per point", counts.points),
        ("W V^-1 W^T", f"162 per product, {counts.num_block_products} products", counts.products),
        ("factorise S", f"n^3 / 3, n = 6 x {cameras} = {counts.num_reduced_unknowns}",
         counts.reduced),
        ("together", "points eliminated first", counts.schur),
        ("all at once", f"n^3 / 3, n = {counts.num_unknowns}", counts.dense),
    ]  # fmt: skip
    rows = [(name, formula, number(flops)) for name, formula, flops in terms]
    ratio = counts.dense / counts.schur
    return Report(
        command="inspect",
        headline=[
            f"{plural(cameras, 'camera')} and {plural(points, 'point')}, each seen by {track}: "
            f"{number(counts.schur)} flops per step with the points eliminated first, "
            f"{number(counts.dense)} without ({number(ratio)} times as many)."
        ],
        sections=[
            Section(
                tables=[Table.of(("term", "formula", "flops"), rows, left=2)],
                notes=[
                    "A textbook estimate, with a dense S. `bundle inspect INPUT` counts the "
                    "work of a solver on your problem."
                ],
            ),
            _needs(needs),
        ],
        data={
            "shape": dict(shape),
            **fields(counts),
            "schur": counts.schur,
            "needs": needs,
            "wall_time": {"total": wall_time},
        },
    )


def _needs(needs: ProblemNeeds) -> Section:
    submaps = plural(needs.num_submaps, "submap")
    system = format_size(needs.system_in_bytes)
    facts = [
        ("observations", f"{needs.num_observations:,}"),
        ("in memory", f"{format_size(needs.memory_in_bytes)} and S with its factor, {system} or "
                      "more"),
        ("out of core", f"{submaps} of {format_size(needs.disk_in_bytes)} of disk and "
                        f"{format_size(needs.resident_in_bytes)} of memory or more"),
        ("processor", f"{number(needs.processor_seconds_per_step)} s per step, as measured with "
                      "500 million observations"),
    ]  # fmt: skip
    notes = ["`bundle refine INPUT -o OUTPUT --out-of-core DIR` keeps observations and points on "
             "a disk."]  # fmt: skip
    if needs.num_submaps > 1:
        notes.append(
            "One solve has at most 1,073,741,823 observations: divide the problem into submaps "
            "that share images (separators). `refine --only-images --rest marginal` eliminates "
            "everything else exactly. The "
            f"dense system of {needs.most_separator_images:,} images fits into the free memory."
        )
    return Section(facts=facts, notes=notes)


# Largest number of steps, and of members of a step, that a terminal shows.
MOST_STEPS, MOST_MEMBERS = 100, 8

SHORT = 12  # number of steps up to which they are shown without --verbose


def inspected_steps(path: str, graph: GraphInspection, wall_time: float) -> Report:
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
