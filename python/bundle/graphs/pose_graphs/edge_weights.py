"""Information of edges: checks, isotropic replacements, and weights of a loss.

``densest_set`` bounds the largest clique. A clique of d vertices gives each of them d - 1
neighbours. The largest d for which d vertices have d - 1 neighbours or more is therefore not
smaller than the largest clique. Odometry with closures has about 4, and a few more closures do not
change it. A marginal prior on d variables raises it to d, so the number distinguishes a dense prior
from more measurements.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import check_type, refuse_row
from bundle.base.paths import as_path, is_path
from bundle.base.records import dataclass
from bundle.base.tails import ONE_IN_2000
from bundle.base.words import distinct, plural
from bundle.errors import InputError
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.option_fields import choice
from bundle.interface.pose_graph_options import POSE_ERRORS, PoseGraphOptions
from bundle.io.g2o_files import load_g2o
from bundle.io.recognition import is_pose_graph_file
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.model.starts import started


@dataclass(frozen=True)
class WeightedGraph:
    """Graph whose information is multiplied by the weights of the loss."""

    given: PoseGraph  # the given graph
    graph: PoseGraph  # the weighted graph, without edges of weight 0
    edges: NDArray[np.int64]  # (k,) positions in ``given`` of the edges of ``graph``
    weights: NDArray[np.float64]  # (m,) weights of the edges of ``given``
    options: PoseGraphOptions  # options as used


def is_graph(source: object) -> bool:
    """Return True for a pose graph, the result of its solve, or the path of one."""
    return isinstance(source, PoseGraph | PoseGraphResult) or is_pose_graph_file(source)


def refuse_for_graphs(**given: Any) -> None:
    """Refuse arguments that only reconstructions support, unless they are empty."""
    for name, value in given.items():
        if value is not None and not (isinstance(value, tuple | list | dict) and not value):
            raise InputError(f"{name}: expected only with a reconstruction, found a graph")


def check_edges_exist(graph: PoseGraph) -> None:
    """Refuse a graph without edges, unless its poses are fixed."""
    if not graph.num_edges and not graph.fixed.all():
        raise InputError(
            f"graph: expected edges, which relate poses, found {plural(graph.num_poses, 'pose')} "
            "and no edge"
        )


def check_free_pose(graph: PoseGraph) -> None:
    """Refuse a graph without a free pose."""
    check_edges_exist(graph)
    held, _, _ = _core.hold_poses(graph)
    if held.all():
        raise InputError(
            f"graph: expected a free pose, found only constant poses ({graph.num_poses})"
        )


def check_information_exists(graph: PoseGraph) -> None:
    """Refuse a graph whose information is 0 on all edges: any poses are a minimum."""
    if not graph.information.any():
        raise InputError(
            "graph: expected information that is not 0, found 0 on all "
            f"{plural(graph.num_edges, 'edge')}"
        )


def weighted_graph(
    source: Any, options: PoseGraphOptions | None, changes: dict[str, Any], caller: str
) -> WeightedGraph:
    """Return a graph at its poses, with the weights of a loss on its edges."""
    weights = None
    if isinstance(source, PoseGraphResult):
        if options is None and not changes:
            weights = source.weights
        options = source.options if options is None else options
        source = source.problem
    elif is_path(source):
        source = load_g2o(as_path(source))
    check_type("graph", source, PoseGraph)
    graph: PoseGraph = source
    if options is not None and not isinstance(options, PoseGraphOptions):
        raise InputError(f"options: expected PoseGraphOptions, found {type(options).__name__}")
    options = PoseGraphOptions.of(options, changes, caller)
    cores = _core.hardware_threads()
    options = options.replace(num_threads=min(options.num_threads or cores, cores))
    if options.loss == "auto" and weights is None:
        raise InputError(
            "loss: expected a named loss, found auto; the result of a solve has the loss "
            "that was chosen"
        )
    weighed = checked_information(graph, options.information)
    if options.consistency and weights is None:
        raise InputError(
            "consistency: expected the result of a solve with consistency, found a graph"
        )
    if weights is None:
        weights = _weights(weighed, options)
    kept = np.flatnonzero(weights > 0)
    used = with_edges(weighed, kept)
    used = used.replace(information=weights[kept, None, None] * used.information)
    return WeightedGraph(graph, used, kept, weights, options)


def with_edges(graph: PoseGraph, edges: NDArray[Any]) -> PoseGraph:
    """Return the graph with some of its edges, given by positions or a mask."""
    return graph.replace(
        edges=graph.edges[edges],
        measurements=graph.measurements[edges],
        information=graph.information[edges],
        edge_lines=graph.edge_lines[edges],
    )


def _weights(graph: PoseGraph, options: PoseGraphOptions) -> NDArray[np.float64]:
    weights = np.ones(graph.num_edges)
    if options.loss == "trivial":
        return weights
    doubted = graph.is_closure if options.loss_on == "closures" else np.ones(graph.num_edges, bool)
    chi2 = _core.edge_chi2(graph, options.error)
    if options.loss == "gnc_tls":
        beyond = options.loss_scale**2 * ONE_IN_2000[graph.tangent_size]
        weights[doubted] = chi2[doubted] <= beyond
        return weights
    for edge in np.flatnonzero(doubted).tolist():
        weights[edge] = _core.edge_loss(options.loss, options.loss_scale, float(chi2[edge]))[1]
    return weights


def initial_poses(graph: PoseGraph, init: str = "chordal") -> NDArray[np.float64]:
    """Return poses from edges alone, relative to the fixed or first pose of each component.

    Args:
        graph: pose graph; not modified.
        init: "odometry", "spanning_tree" or "chordal".

    Raises:
        InputError: for the reasons of :func:`bundle.solve`.
    """
    check_type("graph", graph, PoseGraph)
    init = choice("init", init, ("odometry", "spanning_tree", "chordal"))
    held, _, _ = _core.hold_poses(graph)
    return started(checked_information(graph, "file"), held, init, 1).poses


def pose_graph_chi2(graph: PoseGraph, error: str = "log") -> NDArray[np.float64]:
    """Return r^T Omega r of each edge at the graph's poses: (m,).

    Args:
        graph: pose graph; not modified.
        error: "log", "g2o" or "ceres", as in :class:`PoseGraphOptions`.

    Raises:
        InputError: an information matrix is asymmetric or indefinite.
    """
    check_type("graph", graph, PoseGraph)
    error = choice("error", error, POSE_ERRORS)
    return _core.edge_chi2(checked_information(graph, "file"), error)


def densest_set(edges: NDArray[np.integer]) -> int:
    """Return the largest d for which d vertices have d - 1 neighbours or more.

    ``edges``: (m, 2) pairs of vertices; repeated and reversed pairs count once.
    """
    pairs = np.unique(np.sort(edges.astype(np.int64), axis=1), axis=0).reshape(-1, 2)
    degrees = np.sort(np.bincount(pairs.ravel()))[::-1]
    fits = degrees >= np.arange(len(degrees))
    return int(fits.sum()) if len(pairs) else 0


ORDERS = {
    "g2o": ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)),
    "toro": ((0, 0), (0, 1), (1, 1), (2, 2), (0, 2), (1, 2)),
}
"""Order of an edge's information in planar files."""

NAMES = {"g2o": "g2o", "toro": "TORO"}


def bad_information(graph: PoseGraph) -> list[int]:
    """Return the edges whose information is asymmetric, not finite or not positive semidefinite."""
    return graph.prepared_edges.bad


def describe_information(graph: PoseGraph, edge: int) -> str:
    """Return the error of an edge's information: "expected ..., found ..."."""
    matrix = graph.information[edge]
    if not np.isfinite(matrix).all():
        return "expected finite numbers, found nan or infinity"
    scale = np.sqrt(np.abs(np.outer(np.diag(matrix), np.diag(matrix))))
    apart = np.abs(matrix - matrix.T) / np.maximum(np.maximum(scale, np.abs(matrix)), 1e-300)
    if apart.max() > 1e-9:
        row, column = np.unravel_index(int(np.argmax(apart)), apart.shape)
        one, other = distinct(matrix[row, column], matrix[column, row])
        return (
            f"expected a symmetric matrix, found {one} and {other} across the diagonal at "
            f"[{row}][{column}]"
        )
    values = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    return (
        "expected a positive semidefinite matrix, found eigenvalues from "
        f"{values[0]:g} to {values[-1]:g}"
    )


def checked_information(graph: PoseGraph, information: str) -> PoseGraph:
    """Return the graph with the information that a solve uses."""
    if information == "isotropic":
        return isotropic(graph)
    bad = bad_information(graph)
    if not bad:
        return graph
    hint = _hint_of_order(graph) or "information=isotropic uses the means of the diagonals"
    more = f"; likewise {plural(len(bad) - 1, 'more edge')}" if len(bad) > 1 else ""
    raise InputError(
        f"{graph.edge_name(bad[0])}: information: {describe_information(graph, bad[0])}{more} "
        f"({hint})"
    )


def _hint_of_order(graph: PoseGraph) -> str:
    """Return a hint if the numbers of the file are in the order of the other format.

    In 2D, g2o writes I11 I12 I13 I22 I23 I33 and TORO writes I11 I12 I22 I33 I13 I23.
    """
    other = {"toro": "g2o", "g2o": "toro"}.get(graph.format, "")
    if graph.dimension != 2 or not other:
        return ""
    numbers = [graph.information[:, r, c] for r, c in ORDERS[graph.format]]
    moved = np.empty_like(graph.information)
    for (r, c), column in zip(ORDERS[other], numbers, strict=True):
        moved[:, r, c] = moved[:, c, r] = column
    if bad_information(graph.replace(information=moved)):
        return ""
    edge, vertex = ("EDGE_SE2", "VERTEX_SE2") if other == "g2o" else ("EDGE2", "VERTEX2")
    return (
        f"all are valid in the order of {NAMES[other]}: name the edges {edge} and the "
        f"vertices {vertex}"
    )


def isotropic(graph: PoseGraph) -> PoseGraph:
    """Return the graph with one mean information of rotation and one of translation per edge."""
    diagonal = np.diagonal(graph.information, axis1=1, axis2=2)
    parts = (slice(0, 2), slice(2, 3)) if graph.dimension == 2 else (slice(0, 3), slice(3, 6))
    weights = np.empty_like(diagonal)
    for part in parts:
        weights[:, part] = diagonal[:, part].mean(axis=1, keepdims=True)
    wrong = ~(np.isfinite(weights) & (weights > 0)).all(axis=1)
    refuse_row(
        wrong,
        lambda edge: (
            f"{graph.edge_name(edge)}: information: isotropic expects a diagonal with means above "
            f"0, found {', '.join(f'{weights[edge, part.start]:g}' for part in parts)}"
        ),
    )
    return graph.replace(information=weights[:, :, None] * np.eye(graph.tangent_size))
