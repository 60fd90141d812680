"""Check of the Jacobians that a solve of a pose graph uses.

Error and Jacobians of an edge are those of ``cpp/core/pose_graph/relative_pose.h``, without the
square root of the information, which multiplies both.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bundle._core as _core
from bundle.graphs.factors.factor_check import CheckedFactor, check_each
from bundle.graphs.factors.factor_report import FactorCheck
from bundle.graphs.factors.graph_check import choose
from bundle.graphs.factors.variables import Array, Variable
from bundle.interface.option_fields import choice, number
from bundle.interface.pose_graph_options import POSE_ERRORS
from bundle.model.pose_graph_arrays import PoseGraph


def check_edges(
    graph: PoseGraph,
    error: str = "log",
    *,
    most_of_a_kind: int | None = None,
    progress: Callable[[int], None] | None = None,
    **settings: Any,
) -> FactorCheck:
    """Check the Jacobians of edges; odometry and closures are two kinds.

    Args:
        graph: graph at whose poses to check.
        error: error of the edges, as in a solve.
        most_of_a_kind: largest number of edges of a kind; None: all.
        progress: called with the number of checked edges.
        **settings: settings of :meth:`bundle.FactorGraph.check_gradients`.

    Raises:
        InputError: an argument is out of range.
    """
    error = choice("error", error, POSE_ERRORS)
    if most_of_a_kind is not None:
        most_of_a_kind = number("most_of_a_kind", most_of_a_kind, minimum=1, whole=True)
    manifold = "se2" if graph.poses.shape[1] == 3 else "se3"
    labels = ["closure" if closure else "odometry" for closure in graph.is_closure.tolist()]

    def make(edge: int) -> CheckedFactor:
        ends = graph.edges[edge].tolist()
        keys = [int(graph.ids[end]) for end in ends]
        line = int(graph.edge_lines[edge])
        place = f", line {line}" if line else ""
        variables = [
            Variable.make(key, graph.poses[end], manifold, False, None, None)
            for key, end in zip(keys, ends, strict=True)
        ]
        measured = graph.measurements[edge]

        def function(values: list[Array]) -> tuple[Array, list[Array]]:
            first, second = values
            residual, by_first, by_second = _core.relative_pose_error(
                error, first, second, measured
            )
            return residual, [by_first, by_second]

        name = f"edge {edge} from {keys[0]} to {keys[1]}{place}"
        return CheckedFactor(name, f"edge, {labels[edge]}", labels[edge], variables, function)

    chosen = choose(labels, most_of_a_kind)
    return check_each(map(make, chosen), settings, num_factors=graph.num_edges, progress=progress)
