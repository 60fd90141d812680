"""What `bundle inspect` and `bundle compare` say of a pose graph."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from rich.console import RenderableType

from bundle.base.memory_sizes import format_size
from bundle.base.tables import columns, facts, notes
from bundle.base.words import number, plural, seconds
from bundle.errors import shown
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.comparison.graph_comparison import GraphComparison
from bundle.planning.inspection.pose_graph_inspection import PoseGraphInspection
from bundle.reports.terminal.json import plain
from bundle.reports.terminal.pose_graph_json import heading_of_graph
from bundle.reports.terminal.pose_graph_tables import contents_of_graph

__all__ = ["compared_graph", "comparison_of_graph", "inspected_graph", "inspection_of_graph"]


def inspected_graph(
    path: str, graph: PoseGraph, found: PoseGraphInspection
) -> list[RenderableType]:
    """Return the matrix, a row for each order of elimination, and advice."""
    size = found.block_size * found.num_poses
    rows = [
        ("input", f"{shown(path)} (g2o)"),
        ("", contents_of_graph(graph)),
        ("matrix", f"{size} x {size}, blocks of {found.block_size}"),
        ("nonzeros", f"{found.nnz} ({100 * found.density:.4g} %)"),
        ("free", f"{plural(found.num_free_poses, 'pose')}, {found.nnz_free} nonzeros"),
    ]
    cells = [
        (
            cost.ordering + (" *" if cost.ordering == found.auto_ordering else ""),
            f"{cost.nnz_factor}",
            number(cost.nnz_factor / max(1, (found.nnz_free + _columns_free(found)) / 2)),
            f"{cost.fill}",
            number(cost.flops),
            f"{cost.tree_height}",
            format_size(cost.memory_in_bytes),
        )
        for cost in found.costs
    ]
    head = ("order", "nonzeros of L", "of the matrix", "fill [pairs]", "flops", "height", "memory")
    table: list[RenderableType] = [columns(head, cells), ""] if cells else []
    return [
        facts(rows),
        "",
        *table,
        facts([("advice", found.recommendation)]),
    ]


def _columns_free(found: PoseGraphInspection) -> int:
    """Return the columns of the matrix over the free poses."""
    return found.block_size * found.num_free_poses


def inspection_of_graph(
    path: str, graph: PoseGraph, found: PoseGraphInspection, wall: float
) -> dict[str, Any]:
    """Return the report of `bundle inspect`."""
    return {
        **heading_of_graph("inspect", path, graph),
        **plain(dataclasses.asdict(found)),
        "recommendation": found.recommendation,
        "wall_time": {"total": wall},
    }


def compared_graph(path: str, found: GraphComparison) -> list[RenderableType]:
    """Return one table and one recommendation."""
    rows = []
    for run in found.runs:
        if run.failure:
            rows.append((run.method.name, str(run.method.num_threads), run.failure, "", "", ""))
            continue
        rows.append(
            (
                run.method.name + (" *" if run.method == found.recommended else ""),
                str(run.method.num_threads),
                f"{run.chi2_final:.9g}",
                f"{found.gap(run):.1e}",
                str(run.num_steps),
                seconds(run.time_in_seconds),
            )
        )
    head = ("method", "threads", "chi2", "gap of the cost", "steps", "seconds")
    advice = [("advice", found.reason)]
    if found.command:
        advice.append(("", found.command))
    return [
        facts([("input", f"{shown(path)} (g2o)"), ("", contents_of_graph(found.graph))]),
        "",
        columns(head, rows),
        "",
        facts(advice),
        *notes(found.warnings, style="yellow"),
    ]


def comparison_of_graph(
    path: str, found: GraphComparison, options: Mapping[str, Any], wall: float
) -> dict[str, Any]:
    """Return the report of `bundle compare`."""
    runs = [
        {
            **dataclasses.asdict(run.method),
            "name": run.method.name,
            "times_in_seconds": run.times_in_seconds,
            "time_in_seconds": run.time_in_seconds,
            "final_cost": run.final_cost,
            "chi2_final": run.chi2_final,
            "gap": found.gap(run),
            "num_steps": run.num_steps,
            "termination_type": run.termination_type,
            "failure": run.failure,
            "warnings": list(run.warnings),
        }
        for run in found.runs
    ]
    recommendation = None
    if found.recommended is not None:
        recommendation = {
            "method": dataclasses.asdict(found.recommended),
            "reason": found.reason,
            "command": found.command,
        }
    return {
        **heading_of_graph("compare", path, found.graph),
        "options": plain(dict(options)),
        "repeat": found.repeat,
        "timeout": found.timeout,
        "runs": plain(runs),
        "recommendation": plain(recommendation),
        "wall_time": {"total": wall},
    }
