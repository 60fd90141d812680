"""Elimination of a small graph or subgraph, step by step with a slider."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.track_table import shared_points
from bundle.model.problem import Problem
from bundle.reports.page.page import tag
from bundle.reports.page.table import table

if TYPE_CHECKING:
    from bundle.planning.inspection.graph_inspection import EliminationStep, GraphInspection

# A larger graph would be unreadable on the page.
MOST_VARIABLES = 120
LARGEST_LABELLED = 60
LONGEST_LABEL = 4
SIDE = 400


def elimination_section(graphs: Sequence[GraphInspection]) -> str:
    """Return the slider, the graph, the matrix and the cost; the page's data fill them.

    The graphs are the same one under several orders, with at most MOST_VARIABLES variables.
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
                       "entries of L pale."), class_="grid stage"),
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


# Layout of a small graph, with distances in the plane close to distances in the graph.
#
# Stress majorisation (Gansner, Koren and North 2004) reduces the sum over pairs of
# (distance in the plane / distance in the graph - 1)^2 in every round. The graph determines the
# start, so the same graph always has the same layout. Cycles become circles, and chains
# become lines.

ROUNDS = 300


def place(num_vertices: int, edges: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
    """Return (num_vertices, 2) positions within the unit square."""
    if num_vertices < 3:
        return np.stack([np.linspace(0, 1, num_vertices), np.full(num_vertices, 0.5)], axis=1)
    distance = _distances(num_vertices, edges)
    positions = _classical_scaling(distance)
    np.fill_diagonal(distance, 1.0)
    weight = distance**-2.0
    np.fill_diagonal(weight, 0.0)
    # Weighted Laplacian without its last row and column: a common shift has no effect.
    laplacian = (np.diag(weight.sum(1)) - weight)[:-1, :-1]
    for _ in range(ROUNDS):
        offset = positions[:, None] - positions[None]
        apart = np.linalg.norm(offset, axis=2)
        np.fill_diagonal(apart, 1.0)
        pull = weight * distance / np.maximum(apart, 1e-9)
        target = (pull[..., None] * offset).sum(1)
        positions = np.vstack([np.linalg.solve(laplacian, target[:-1]), [0.0, 0.0]])
    low, high = positions.min(0), positions.max(0)
    centred: NDArray[np.float64] = (positions - (low + high) / 2) / max((high - low).max(), 1e-9)
    return centred + 0.5


def _distances(num_vertices: int, edges: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
    """Return graph distances; between components, 0.75 times the largest distance plus 1.5."""
    distance = np.full((num_vertices, num_vertices), np.inf)
    for a, b in edges:
        distance[a, b] = distance[b, a] = 1.0
    np.fill_diagonal(distance, 0.0)
    for middle in range(num_vertices):
        through = distance[:, [middle]] + distance[[middle]]
        np.minimum(distance, through, out=distance)
    reached = distance[np.isfinite(distance)].max()
    distance[np.isinf(distance)] = 0.75 * reached + 1.5
    return distance


def _classical_scaling(distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the start by classical scaling (Torgerson 1952), the best plane for the distances.

    Vertices at the same position, such as leaves of a star, are moved slightly apart.
    """
    size = len(distance)
    centring = np.eye(size) - 1.0 / size
    values, vectors = np.linalg.eigh(-0.5 * centring @ distance**2 @ centring)
    start = vectors[:, -2:] * np.sqrt(np.maximum(values[-2:], 0.0))
    angle = 2.0 * np.pi * np.arange(size) / size
    return np.stack([start[:, 1], start[:, 0]], axis=1) + 0.2 * np.stack(
        [np.cos(angle), np.sin(angle)], axis=1
    )


# Subgraph of a few images of a problem, small enough for an elimination step by step.
#
# Images that share the most points are all connected with each other, so their elimination shows no
# fill-in. Therefore images are sampled from the whole problem at even steps. The step is as large
# as possible while the sampled images still share points.

MOST_IMAGES = 24
# Edges per image that are enough for visible fill-in.
ENOUGH = 1.5


def image_graph(
    problem: Problem, most: int = MOST_IMAGES
) -> tuple[list[str], list[tuple[int, int]]]:
    """Return (names, edges) of up to ``most`` images; empty if no images share a point.

    Images are renumbered in the order of the problem. An edge joins two images that share points,
    that is, images with a block in S.
    """
    low, high, count = shared_points(problem)
    chosen = spread(low, high, problem.num_images, most)
    if len(chosen) == 0:
        chosen = np.sort(best_connected(low, high, count, most))
    number = {int(image): index for index, image in enumerate(chosen)}
    inside = _inside(low, high, chosen)
    edges = [
        (number[int(a)], number[int(b)]) for a, b in zip(low[inside], high[inside], strict=True)
    ]
    names = [PurePosixPath(problem.image_names[k]).name or f"image {problem.image_ids[k]}"
             for k in chosen]  # fmt: skip
    return names, edges


def spread(
    low: NDArray[np.int64], high: NDArray[np.int64], num_vertices: int, most: int
) -> NDArray[np.int64]:
    """Return up to ``most`` vertices at the largest even step that leaves enough edges.

    They ascend and have edges to others of them; empty if no step leaves enough edges.
    """
    step = -(-num_vertices // most)
    while step > 0:
        taken = np.arange(0, num_vertices, step)[:most]
        inside = _inside(low, high, taken)
        kept = np.unique(np.concatenate([low[inside], high[inside]]))
        if len(kept) > len(taken) / 2 and inside.sum() >= ENOUGH * len(kept):
            return kept
        step //= 2
    return np.empty(0, np.int64)


def _inside(
    low: NDArray[np.int64], high: NDArray[np.int64], chosen: NDArray[np.int64]
) -> NDArray[np.bool_]:
    found: NDArray[np.bool_] = np.isin(low, chosen) & np.isin(high, chosen)
    return found


def best_connected(
    low: NDArray[np.int64], high: NDArray[np.int64], count: NDArray[np.int64], most: int
) -> NDArray[np.int64]:
    """Return up to ``most`` vertices, grown from the heaviest edge by the largest edge weight.

    Fewer if no further vertex is connected. ``count`` has the weights of the edges.
    """
    if len(count) == 0:
        return np.empty(0, np.int64)
    ends = np.stack([np.concatenate([low, high]), np.concatenate([high, low])])
    by_first = np.argsort(ends[0], kind="stable")
    first, second, weight = ends[0][by_first], ends[1][by_first], np.tile(count, 2)[by_first]
    bound = np.zeros(first[-1] + 1)
    heaviest = int(np.argmax(count))
    chosen: list[int] = []
    following = int(low[heaviest])
    while len(chosen) < most:
        chosen.append(following)
        begin, end = np.searchsorted(first, [following, following + 1])
        bound[second[begin:end]] += weight[begin:end]
        bound[chosen] = -1.0
        following = int(np.argmax(bound))
        if bound[following] <= 0:
            break
    return np.array(chosen, np.int64)
