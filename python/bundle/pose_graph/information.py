"""Information matrices that are none, by edge, and isotropic ones in place of all."""

from __future__ import annotations

import numpy as np

from bundle import _core
from bundle.errors import InputError
from bundle.pose_graph.pose_graph_arrays import PoseGraph
from bundle.words import plural

__all__ = ["bad_information", "checked_information", "describe_information", "isotropic"]


def bad_information(graph: PoseGraph) -> list[int]:
    """Return the edges whose information is asymmetric, not finite or not positive semidefinite."""
    return [int(edge) for edge in _core.find_bad_information(graph.information)]


def describe_information(graph: PoseGraph, edge: int) -> str:
    """Return what is wrong with the information of an edge: "expected ..., found ..."."""
    matrix = graph.information[edge]
    if not np.isfinite(matrix).all():
        return "expected finite numbers, found some that are not"
    scale = np.sqrt(np.abs(np.outer(np.diag(matrix), np.diag(matrix))))
    apart = np.abs(matrix - matrix.T) / np.maximum(np.maximum(scale, np.abs(matrix)), 1e-300)
    if apart.max() > 1e-9:
        row, column = np.unravel_index(int(np.argmax(apart)), apart.shape)
        return (
            f"expected a symmetric matrix, found {matrix[row, column]:g} and "
            f"{matrix[column, row]:g} across the diagonal at [{row}][{column}]"
        )
    values = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    return (
        "expected a positive semidefinite matrix, found eigenvalues from "
        f"{values[0]:g} to {values[-1]:g}"
    )


def checked_information(graph: PoseGraph, information: str) -> PoseGraph:
    """Return the graph with the information that a solve is to take.

    Raises:
        InputError: the information of an edge is none; the message names the edge.
    """
    if information == "isotropic":
        return isotropic(graph)
    bad = bad_information(graph)
    if not bad:
        return graph
    more = f"; so are those of {plural(len(bad) - 1, 'more edge')}" if len(bad) > 1 else ""
    raise InputError(
        f"{graph.edge_name(bad[0])}: information: {describe_information(graph, bad[0])}{more} "
        "(information=isotropic takes the means of the diagonals)"
    )


def isotropic(graph: PoseGraph) -> PoseGraph:
    """Return the graph with information that has no direction.

    That of an edge becomes diagonal: one number for its rotation and one for its translation, the
    means of the diagonals over each.

    Raises:
        InputError: such a mean is not finite, or not above 0; the message names the edge.
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
            f"{graph.edge_name(edge)}: information: expected means of the diagonal above 0 for "
            f"isotropic, found {', '.join(f'{weights[edge, part.start]:g}' for part in parts)}"
        )
    return graph.replace(information=weights[:, :, None] * np.eye(graph.tangent_size))
