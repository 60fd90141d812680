"""Checks of information matrices of edges, and isotropic replacements."""

from __future__ import annotations

import numpy as np

from bundle.base.words import distinct, plural
from bundle.errors import InputError
from bundle.model.pose_graph_arrays import PoseGraph

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

    In the plane, g2o writes I11 I12 I13 I22 I23 I33 and TORO writes I11 I12 I22 I33 I13 I23.
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
    """Return the graph with isotropic information.

    The information of an edge becomes diagonal: one number for its rotation and one for its
    translation, the means of their diagonals.
    """
    diagonal = np.diagonal(graph.information, axis1=1, axis2=2)
    parts = (slice(0, 2), slice(2, 3)) if graph.dimension == 2 else (slice(0, 3), slice(3, 6))
    weights = np.empty_like(diagonal)
    for part in parts:
        weights[:, part] = diagonal[:, part].mean(axis=1, keepdims=True)
    wrong = ~(np.isfinite(weights) & (weights > 0)).all(axis=1)
    if wrong.any():
        edge = int(np.argmax(wrong))
        raise InputError(
            f"{graph.edge_name(edge)}: information: isotropic expects a diagonal with means above "
            f"0, found {', '.join(f'{weights[edge, part.start]:g}' for part in parts)}"
        )
    return graph.replace(information=weights[:, :, None] * np.eye(graph.tangent_size))
