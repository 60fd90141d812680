"""Elimination of a small graph, step by step with a slider."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from bundle.reports.page.page import tag
from bundle.reports.page.table import table
from bundle.reports.page.vertex_positions import place

if TYPE_CHECKING:
    from bundle.planning.inspection.graph_inspection import EliminationStep, GraphInspection

# A larger graph would be unreadable on the page.
MOST_VARIABLES = 120
LARGEST_LABELLED = 60
LONGEST_LABEL = 4
SIDE = 400


def elimination_section(graphs: Sequence[GraphInspection]) -> str:
    """Return the slider, the graph, the matrix and the cost; the page's data fill them.

    Args:
        graphs: the same graph under each available order, with at most MOST_VARIABLES variables.
    """
    steps = [
        tag("h3", f"Order {escape(order_name(graph))}, every step") + _steps(graph)
        for graph in graphs
    ]
    return "".join(
        [
            _controls(graphs),
            tag("p", id="sentence", aria_live="polite"),
            tag("dl", _bill("total-fill", "fill edges so far"),
                _bill("total-flops", "flops so far (c² + 3c a step)"),
                _bill("where", "eliminated"), class_="bill"),
            tag("div", _stage("graph", "Eliminated variables are grey, fill edges are orange."),
                _stage("matrix", "Rows and columns in the order of elimination: fill is orange, "
                       "what has become part of L pale."), class_="grid stage"),
            tag("details", tag("summary", "All steps as a table"), *steps),
        ]
    )  # fmt: skip


def elimination_data(graphs: Sequence[GraphInspection]) -> dict[str, Any]:
    """Return the data that the script draws."""
    first = graphs[0]
    count = first.num_variables
    radius = float(np.clip(70.0 / np.sqrt(max(count, 1)), 4.0, 17.0))
    margin = radius + 3.0
    positions = place(count, first.edges) * (SIDE - 2.0 * margin)
    positions += margin - positions.min(0, initial=SIDE)
    return {
        "names": list(first.names),
        "labels": _labels(first.names),
        "edges": [list(edge) for edge in first.edges],
        "positions": positions.round(1).tolist(),
        "height": round(float(positions[:, 1].max(initial=0.0)) + margin, 1),
        "radius": round(radius, 1),
        "runs": [_run(graph) for graph in graphs],
    }


def order_name(graph: GraphInspection) -> str:
    """Return the words for a graph's elimination order."""
    return graph.ordering.replace("_", " ")


def _run(graph: GraphInspection) -> dict[str, Any]:
    return {
        "ordering": order_name(graph),
        "order": list(graph.order),
        "fill": graph.fill,
        "flops": graph.flops,
        "steps": [
            {
                "variable": step.variable,
                "neighbours": list(step.neighbours),
                "fill": [list(edge) for edge in step.fill],
                "flops": step.flops,
                "total_fill": step.total_fill,
                "total_flops": step.total_flops,
            }
            for step in graph.steps
        ],
    }


def _labels(names: Sequence[str]) -> list[str]:
    """Return the text of each circle: short names, or numbers, or no text."""
    if len(names) > LARGEST_LABELLED:
        return [""] * len(names)
    if all(len(name) <= LONGEST_LABEL for name in names):
        return list(names)
    return [str(number) for number in range(len(names))]


def _controls(graphs: Sequence[GraphInspection]) -> str:
    chooser = ""
    if len(graphs) > 1:
        options = [
            tag("option", f"order {escape(order_name(graph))}: {graph.fill:,} fill, "
                f"{graph.flops:,} flops", value=index)
            for index, graph in enumerate(graphs)
        ]  # fmt: skip
        chooser = tag("select", *options, id="run", aria_label="order of elimination")
    slider = tag(
        "input", type="range", id="step", min=0, max=graphs[0].num_variables, value=0,
        step=1, aria_label="variables eliminated",
    )  # fmt: skip
    buttons = [
        tag("button", "Play", id="play", type="button"),
        tag("button", "◀", id="back", type="button", aria_label="one step back"),
        slider,
        tag("button", "▶", id="forward", type="button", aria_label="one step forward"),
    ]
    hint = tag("p", "Arrow keys step, Home and End jump, the space bar plays.", class_="quiet")
    missing = tag("noscript", tag("p", "Stepping needs JavaScript; the table below does not."))
    return tag("div", chooser, *buttons, class_="controls") + hint + missing


def _bill(name: str, words: str) -> str:
    return tag("div", tag("dt", words), tag("dd", "0", id=name))


def _stage(name: str, words: str) -> str:
    drawing = tag("svg", id=name, viewBox=f"0 0 {SIDE} {SIDE}", role="img", aria_label=words)
    return tag("figure", drawing, tag("figcaption", words))


def _steps(graph: GraphInspection) -> str:
    def words(number: int, step: EliminationStep) -> list[str]:
        def named(variables: Sequence[int]) -> str:
            return ", ".join(graph.names[variable] for variable in variables) or "none"

        fill = ", ".join("-".join(graph.names[end] for end in edge) for edge in step.fill)
        return [
            graph.names[step.variable], f"{number}", named(step.neighbours), fill or "none",
            f"{step.flops:,}", f"{step.total_fill:,}", f"{step.total_flops:,}",
        ]  # fmt: skip

    rows = [words(number, step) for number, step in enumerate(graph.steps, 1)]
    head = ["eliminated", "step", "meets", "fill", "flops", "fill so far", "flops so far"]
    return table(head, rows, words={2, 3})
