"""What `bundle inspect` says of a problem."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

from rich.console import RenderableType

from bundle.base.memory_sizes import format_size
from bundle.base.tables import Columns, CommandLine, columns, facts, format_name, notes, number
from bundle.base.words import contents, duration, plural
from bundle.errors import shown
from bundle.interface.options import SolveOptions
from bundle.model.problem import Problem
from bundle.planning.comparison.command_line import recommended_command
from bundle.planning.inspection.inspection_result import Inspection, MethodInspection
from bundle.reports.terminal import json
from bundle.reports.terminal.rig_tables import rig_fact

__all__ = ["CONVENTION", "as_json", "inspected"]

CONVENTION = (
    "Nonzeros count both triangles and the diagonal; those of the factor L, its lower triangle "
    "with the diagonal."
)

_CLEARLY_SLOWER = 1.25


def inspected(
    path: str, problem: Problem, inspection: Inspection, options: SolveOptions
) -> list[RenderableType]:
    """Return the predictions for a problem as tables and sentences."""
    command = recommended_command(inspection, options, shown(path))
    return [
        facts(
            [
                ("input", f"{shown(path)} ({format_name(problem.format)})"),
                ("", contents(problem)),
                *rig_fact(problem),
                ("unknowns", _unknowns(inspection)),
                ("nonzeros", _nonzeros(inspection)),
                ("", CONVENTION),
            ]
        ),
        "",
        _factors(inspection.methods),
        "",
        _costs(inspection),
        "",
        facts([("recommended", inspection.recommendation)]),
        *_copyable(command),
        *notes(_remarks(inspection)),
    ]


def as_json(
    path: str,
    problem: Problem,
    inspection: Inspection,
    options: SolveOptions,
    names: Iterable[str],
    wall_time: float,
) -> dict[str, Any]:
    """Return the report of `bundle inspect` for programs.

    Args:
        path: of the input.
        problem: what was inspected.
        inspection: what was found.
        options: with which.
        names: of the options that count for an inspection.
        wall_time: seconds.
    """
    return {
        **json.heading("inspect", path, problem),
        "options": json.plain({name: getattr(options, name) for name in names}),
        **json.plain(dataclasses.asdict(inspection)),
        "recommended_command": recommended_command(inspection, options, path),
        "nonzeros": CONVENTION,
        "wall_time": {"total": wall_time},
    }


def _unknowns(inspection: Inspection) -> str:
    method = inspection.methods[0]
    return (
        f"{method.num_unknowns}: {plural(inspection.num_free_points, 'point')}, and "
        f"{inspection.num_camera_columns} in {inspection.num_camera_blocks} blocks of cameras"
    )


def _nonzeros(inspection: Inspection) -> str:
    method = inspection.methods[0]
    full = f"{100.0 * inspection.reduced_density:.3g} % full"
    reduced = f", S {number(method.nnz_reduced)} ({full})" if method.nnz_reduced else ""
    return (
        f"J {number(method.nnz_jacobian)}, information matrix {number(method.nnz_information)}"
        f"{reduced}"
    )


def _factors(methods: Sequence[MethodInspection]) -> Columns:
    """Return a row for each way to factorise, of any backend."""
    rows = {}
    for method in methods:
        if method.nnz_factor:
            rows[method.name] = (
                method.name,
                number(method.nnz_factor),
                number(method.fill),
                number(method.flops),
                number(method.cholmod_flops),
                str(method.tree_height),
                str(max(method.column_count_profile)),
            )
    head = ("factor L", "nonzeros", "fill", "flops", "CHOLMOD's", "height", "fullest")
    return columns(head, rows.values())


def _costs(inspection: Inspection) -> Columns:
    names = dict.fromkeys(method.name for method in inspection.methods)
    by_key = {(method.name, method.backend): method for method in inspection.methods}
    rows = []
    for name in names:
        ours = by_key.get((name, "FUSED")) or by_key.get((name, ""))
        theirs = by_key.get((name, "CERES"))
        chosen = inspection.recommended >= 0 and name == _best(inspection).name
        rows.append(
            (
                f"{name} <" if chosen else name,
                *_cost(ours),
                *_cost(theirs),
            )
        )
    head = ("method", "fused: memory", "fused: per step", "Ceres: memory", "Ceres: per step")
    return columns(head, rows)


def _cost(method: MethodInspection | None) -> tuple[str, str]:
    if method is None:
        return "-", "-"
    memory = format_size(method.memory_in_bytes)
    if not method.fits_in_memory:
        return f"{memory} !", "-"
    time = duration(method.time_per_step_in_seconds)
    return memory, time if method.is_taken else f"({time})"


def _copyable(command: str) -> list[RenderableType]:
    return ["", CommandLine(command), ""] if command else []


def _best(inspection: Inspection) -> MethodInspection:
    return inspection.methods[inspection.recommended]


def _remarks(inspection: Inspection) -> list[str]:
    free = format_size(inspection.available_memory_in_bytes)
    remarks = [
        "flops are the sum of c^2 + 3 c over the columns of L, c their entries below the diagonal, "
        'and those under "CHOLMOD\'s" its own sum of (c + 1)^2; fill is in pairs of blocks; the '
        "height is that of the elimination tree, in blocks; the fullest column of L has as many "
        "entries below the diagonal.",
        f"Times are for {plural(inspection.num_threads, 'thread')}, by this machine's measured "
        f"rates; memory is the peak beyond the problem, of {free} free.",
    ]
    if any(not method.fits_in_memory for method in inspection.methods):
        remarks.append("! does not fit into the memory that is free.")
    if any(not method.is_taken for method in inspection.methods):
        remarks.append(
            "(in brackets) for comparison: the fused backend takes the order of natural, AMD and "
            "METIS that makes the fewest flops, Ceres takes AMD's."
        )
    remarks += _disagreement(inspection)
    by_note: dict[str, dict[str, str]] = {}
    for method in inspection.methods:
        if method.note and method.is_taken:
            by_note.setdefault(method.note, {})[method.name] = method.linear_solver_type
    return remarks + [f"{_whose(names)}: {note}." for note, names in by_note.items()]


def _whose(names: dict[str, str]) -> str:
    """Return the methods, or their linear solver where they are many and have one."""
    solvers = dict.fromkeys(names.values())
    return ", ".join(solvers if len(names) > 2 and len(solvers) == 1 else names)


def _disagreement(inspection: Inspection) -> list[str]:
    """Return a remark where `--solver auto` takes what is predicted to be clearly slower."""
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
        f"`--solver auto` would take {inspection.auto_choice}: it goes by the rates of a fixed "
        "machine. `bundle compare` measures who is right."
    ]
