"""``bundle.report`` of every kind of input."""

from __future__ import annotations

import os
from typing import Any

from bundle.base.arrays import check_type
from bundle.base.paths import as_path, is_path
from bundle.errors import InputError
from bundle.graphs.factors.factor_graph import FactorGraph, GraphResult
from bundle.graphs.pose_graphs.edge_weights import is_graph, refuse_for_graphs
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.io.files import Source
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.reports.page.graph_report import write_graph_report
from bundle.reports.page.report_page import write_report
from bundle.solving.result import Result


def report(
    source: Source | Result | PoseGraph | PoseGraphResult | FactorGraph,
    path: str | os.PathLike[str],
    *,
    result: GraphResult | None = None,
    name: str = "",
    **of_reconstructions: Any,
) -> tuple[str, ...]:
    """Write one self-contained HTML page about a reconstruction, a pose graph or a factor graph.

    The page of a graph has chi2 by kind of edge against its expectation, the worst edges, rank and
    certainty, convergence, the cost of each elimination order, and its trajectory in two and three
    dimensions. A :class:`FactorGraph` of reprojections has the page of the problem that it states.

    Args:
        source: problem, pose graph or factor graph; the path of a problem or of a pose graph; or
            the result of a solve. Only a result has values before and after.
        path: path of the page. A failed write leaves no partial file.
        result: result of the factor graph ``source``.
        name: name of the input, for the title.
        **of_reconstructions: further arguments of :func:`bundle.html.write_report`.

    Returns:
        One sentence per missing part; the page has the same sentences.

    Raises:
        InputError: the input or an argument is invalid, or the path cannot hold a page.
        OSError: the input cannot be read, or the page cannot be written.
    """
    check_type("name", name, str)
    if isinstance(source, FactorGraph):
        if result is not None:
            check_type("result", result, GraphResult)
        solved = source if result is None else source.with_values(result.values)
        found = solved.as_problem()
        if found is not None:
            return write_report(found[0], path, name=name, **of_reconstructions)
    elif result is not None:
        raise InputError("result: expected only with a factor graph")
    if isinstance(source, FactorGraph) or is_graph(source):
        refuse_for_graphs(**of_reconstructions)
        if is_path(source):
            source = load_g2o(as_path(source))
        write_graph_report(source, path, result=result, name=name)  # type: ignore[arg-type]
        return ()
    return write_report(source, path, name=name, **of_reconstructions)  # type: ignore[arg-type]
