"""Reports of `bundle inspect` and `bundle compare` on a pose graph."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from bundle.base.words import amount, format_size, number, plural, seconds, span
from bundle.graphs.pose_graphs.edge_weights import densest_set
from bundle.model.content_digests import content_digests
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.comparison.graph_comparison import GraphComparison, GraphRun
from bundle.planning.inspection.elimination_costs import CONVENTION, FactorGraphInspection
from bundle.planning.inspection.inspection_result import EliminationCost
from bundle.reports.sections import Column, Report, Section, Table, fields, records
from bundle.reports.terminal.inputs import about_input, input_facts

if TYPE_CHECKING:
    from bundle.figures.marks import Figure

LEGEND = "* selected by auto; [not offered by a solve]."


def inspected_graph(
    path: str, graph: PoseGraph, found: FactorGraphInspection, wall_time: float
) -> Report:
    """Return the matrix, a row for each elimination order, and advice; wall_time in seconds."""
    size = found.block_size * found.num_poses
    facts = [
        *input_facts(path, graph),
        ("matrix", f"{size} x {size}, blocks of {found.block_size}"),
        ("nonzeros", f"{found.nnz} ({100 * found.density:.4g} %)"),
        ("free", f"{plural(found.num_free_poses, 'pose')}, {found.nnz_free} nonzeros"),
        ("", CONVENTION),
    ]
    return Report(
        command="inspect",
        input=about_input(path, graph),
        headline=[found.recommendation, _predicted(found)],
        sections=[Section(tables=[cost_table(found)]), Section(facts=facts, is_detail=True)],
        data={
            **fields(found),
            "num_poses": found.num_poses,
            "num_free_poses": found.num_free_poses,
            "recommendation": found.recommendation,
            "nonzeros": CONVENTION,
            "wall_time": {"total": wall_time},
        },
    )


def cost_table(found: FactorGraphInspection) -> Table:
    """Return a row for each elimination order; pages highlight the one that `auto` selects."""
    free = max(1, (found.num_columns + found.nnz_free) / 2)
    columns = (
        Column("order", lambda cost: _order(cost, found.auto_ordering)),
        Column("nonzeros of L", "nnz_factor"),
        Column("of the matrix", lambda cost: number(cost.nnz_factor / free)),
        Column("fill [pairs]", "fill"),
        Column("flops", "flops", number),
        Column("height", "tree_height"),
        Column("memory", "memory_in_bytes", format_size),
        Column("a step", "time_per_step_in_seconds", lambda time: span(time)),
    )
    names = [cost.ordering for cost in found.costs]
    best = names.index(found.auto_ordering)
    return Table(columns, found.costs, legend=LEGEND, best=best)


def _predicted(found: FactorGraphInspection) -> str:
    chosen = next(cost for cost in found.costs if cost.ordering == found.auto_ordering)
    return (
        f"Predicted: {span(chosen.time_per_step_in_seconds)} per step and "
        f"{format_size(chosen.memory_in_bytes)} on {plural(found.num_threads, 'thread')}, for "
        f"{plural(found.num_columns, 'unknown', grouped=True)}."
    )


def _order(cost: EliminationCost, chosen: str) -> str:
    if not cost.is_taken:
        return f"[{cost.ordering}]"
    return f"{cost.ordering} *" if cost.ordering == chosen else cost.ordering


def compared_graph(
    path: str,
    graph: PoseGraph,
    found: GraphComparison,
    options: Mapping[str, Any],
    wall_time: float,
    orders_only: bool = False,
) -> Report:
    """Return a row for each run, and a recommendation."""
    best = found.recommended
    made = compared_runs(found, path, orders_only)
    return dataclasses.replace(
        made,
        input=about_input(path, graph) | {"digests": content_digests(graph)},
        sections=[Section(facts=input_facts(path, graph)), *made.sections],
        data={
            "options": dict(options),
            "environment": found.environment,
            "structure": {"densest": densest_set(graph.edges)},
            "repeat": found.repeat,
            "timeout": found.timeout,
            "runs": [_run(found, run) for run in found.runs],
            "recommendation": None
            if best is None
            else {"method": best, "reason": found.reason, "command": found.command},
            "wall_time": {"total": wall_time},
        },
    )


def compared_runs(found: GraphComparison, name: str, orders_only: bool = False) -> Report:
    """Return the report on the runs alone, without data."""
    median = f" Times are medians of {found.repeat} solves." if found.repeat > 1 else ""
    conditions = (
        f"{plural(len(found.runs), 'method')} from one start, each stopped after "
        f"{found.timeout:g} seconds.{median} {found.environment.sentence}"
    )

    def figures() -> list[Figure]:
        from bundle.figures import cost_figures as of

        usable = [run for run in found.runs if not run.failure]
        return [of.graph_time_figure(found), of.graph_breakdown_figure(found)] if usable else []

    advice = [("advice", found.reason), *([("", found.command)] if found.command else [])]
    return Report(
        command="compare",
        title=f"Solvers compared: {name}",
        headline=[found.reason],
        sections=[
            Section(title="Methods", tables=[run_table(found, orders_only)]),
            Section(facts=advice, notes=found.warnings, is_warning=True),
            Section(title="Time", text=[conditions], figures=figures, is_page_only=True),
        ],
    )


def run_table(found: GraphComparison, orders_only: bool = False) -> Table:
    """Return a row for each run, with the cost of the order if the methods differ in it only."""

    def measured(write: Any) -> Any:
        return lambda run: "" if run.failure else write(run)

    def name(run: GraphRun) -> str:
        mark = " *" if run.method == found.recommended and not run.failure else ""
        return f"{run.method.ordering if orders_only else run.method.name}{mark}"

    gap = Column("gap of the cost", measured(lambda run: f"{found.gap(run):.1e}"))
    threads = Column("threads", "method.num_threads")
    sizes = (
        Column("nnz(L)", measured(lambda run: _known(run, "num_factor_nonzeros", amount))),
        Column("flops", measured(lambda run: _known(run, "factor_flops", number))),
    )
    columns = (
        Column("order" if orders_only else "method", name),
        *(() if orders_only else (threads,)),
        Column("chi2", lambda run: run.failure or f"{run.chi2_final:.9g}"),
        *(() if orders_only else (gap,)),
        Column("sigmas", measured(lambda run: f"{found.distance_in_sigmas(run):.1e}")),
        Column("steps", measured(lambda run: str(run.num_steps))),
        *(sizes if orders_only else ()),
        Column("seconds", measured(lambda run: seconds(run.time_in_seconds))),
        Column("a step", measured(lambda run: span(run.time_per_step_in_seconds))),
        Column("predicted", measured(lambda run: span(run.predicted_time_per_step_in_seconds))),
    )
    return Table(columns, found.runs)


def _known(run: GraphRun, name: str, write: Callable[[float], str]) -> str:
    value = getattr(run.result.summary, name)
    return "-" if value is None else write(value)


OF_RUN = (
    *("times_in_seconds", "time_in_seconds", "final_cost", "chi2_final", "num_steps", "failure"),
    *("time_per_step_in_seconds", "predicted_time_per_step_in_seconds", "termination_type"),
    "warnings",
)
"""Properties of a run for programs."""


def _run(found: GraphComparison, run: GraphRun) -> dict[str, Any]:
    return {
        **fields(run.method),
        "name": run.method.name,
        **{name: getattr(run, name) for name in OF_RUN},
        "gap": found.gap(run),
        "distance_in_sigmas": found.distance_in_sigmas(run),
        "summary": run.result and run.result.summary,
        "iterations": [] if run.result is None else records(run.result.iterations),
    }
