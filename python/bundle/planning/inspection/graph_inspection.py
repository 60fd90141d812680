"""``inspect_graph``: what eliminating a graph costs in some order, without arithmetic."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from bundle import _core
from bundle.base.arguments import as_flag
from bundle.base.display import Display, Displayed
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.interface.option_fields import choice
from bundle.interface.options import GRAPH_ORDERINGS
from bundle.planning.inspection.elimination import EliminationStep, eliminate, minimum_degree_order
from bundle.planning.inspection.graph_input import (
    as_block_sizes,
    as_edges,
    as_names,
    as_variables,
)

__all__ = ["GRAPH_ORDERINGS", "GraphInspection", "inspect_graph", "pattern_of_edges"]

# Steps are recorded unasked where they look at no more pairs of neighbours than this: in about a
# second, for some hundred variables or thousands with little fill.
MOST_PAIRS_TO_RECORD = 2_000_000


@dataclass(frozen=True, repr=False)
class GraphInspection(Displayed):
    """The Cholesky factor L of a matrix with a given graph, known before any arithmetic.

    Nonzeros of the matrix count both triangles and the diagonal; those of L count its lower
    triangle with the diagonal. A variable is a full block of ``block_sizes`` scalars.

    Attributes:
        num_variables: vertices of the graph.
        names: of the variables.
        edges: pairs of variables (smaller, larger) that meet, ascending, each once.
        ordering: name of the order, "given" for one that was handed in.
        order: ``order[k]`` is eliminated as the k-th.
        steps: what happened at each; empty where they were not recorded.
        column_counts: (num_variables,) in elimination order: neighbours left when eliminated, the
            blocks below the diagonal of L.
        fill: edges created on the way.
        flops: sum of c^2 + 3 c over the scalar columns of L, c their entries below the diagonal: a
            multiplication and a subtraction for each of the c (c + 1) / 2 entries of a triangle
            and c of the right hand side that eliminating the column changes.
        cholmod_flops: sum of (c + 1)^2, which CHOLMOD's analysis reports (``fl``).
        nnz: nonzeros of the matrix.
        nnz_factor: nonzeros of L.
        tree_height: variables on the longest path through the elimination tree: steps that must
            follow each other.
        block_sizes: scalars of each variable.
        landmarks: the variables that ``landmarks_first`` begins with.
    """

    num_variables: int
    names: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]
    ordering: str
    order: tuple[int, ...]
    steps: tuple[EliminationStep, ...]
    column_counts: tuple[int, ...]
    fill: int
    flops: int
    cholmod_flops: int
    nnz: int
    nnz_factor: int
    tree_height: int
    block_sizes: tuple[int, ...]
    landmarks: tuple[int, ...] = ()

    @property
    def num_columns(self) -> int:
        """Scalar columns of the matrix."""
        return sum(self.block_sizes)

    @property
    def density(self) -> float:
        """Share of the matrix' cells that are not zero."""
        return self.nnz / max(1, self.num_columns) ** 2

    @cached_property
    def scalar_column_counts(self) -> tuple[int, ...]:
        """(num_columns,) in elimination order: entries below the diagonal of L."""
        counts = _core.count_factor(*self.pattern(), np.array(self.order, np.int32))
        return tuple(
            below + left
            for variable, below in zip(self.order, counts["rows_below"].tolist(), strict=True)
            for left in reversed(range(self.block_sizes[variable]))
        )

    def _display(self) -> Display:
        graph = f"{plural(self.num_variables, 'variable')}, {plural(len(self.edges), 'edge')}"
        facts = (
            ("ordering", self.ordering),
            ("fill", plural(self.fill, "edge")),
            ("flops", str(self.flops)),
            ("nonzeros", f"{self.nnz} of the matrix, {self.nnz_factor} of its factor L"),
            ("tree height", str(self.tree_height)),
        )
        return Display(title=f"GraphInspection: {graph}", facts=facts)

    def pattern(self) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]:
        """Return (sizes, column_begin, rows) as the core takes a matrix' lower triangle."""
        edges = np.array(self.edges, np.int64).reshape(-1, 2)
        return pattern_of_edges(np.array(self.block_sizes, np.int32), edges)


def inspect_graph(
    edges: Iterable[Sequence[int]] | NDArray[np.integer],
    num_variables: int | None = None,
    ordering: str | Sequence[int] = "natural",
    *,
    names: Sequence[str] | None = None,
    landmarks: Iterable[int] = (),
    block_size: int | Sequence[int] = 1,
    record_steps: bool | None = None,
) -> GraphInspection:
    """Eliminate the variables of a graph in some order and count what it costs.

    Orders: "natural" and "reverse" by index; "landmarks_first" takes ``landmarks`` and then the
    others, both by index; "minimum_degree" takes one with the fewest neighbours left, ties by
    index; "amd", "colamd", "metis" and "nesdis" are CHOLMOD's.

    Args:
        edges: (num_edges, 2) pairs of variables that meet. An edge more than once, or both ways
            round, is one edge.
        num_variables: numbered from 0; by default as many as there are names, or up to the largest
            in an edge.
        ordering: one of ``GRAPH_ORDERINGS``, in any case, with hyphens or underscores, or all
            variables in the order in which they are to be eliminated.
        names: of the variables; by default their numbers.
        landmarks: variables.
        block_size: scalars of each variable, such as 6 for poses; one number or one a variable.
        record_steps: whether to keep every step; by default where that is quick.

    Raises:
        InputError: an edge from a variable to itself, a variable out of range, an order that is no
            permutation, or any other argument that makes no sense.
    """
    pairs = as_edges(edges)
    labels = as_names(names, pairs, num_variables)
    n = len(labels)
    pairs = np.unique(np.sort(as_variables("edges", pairs, n), axis=1), axis=0)
    sizes = as_block_sizes(block_size, n)
    first = np.unique(as_variables("landmarks", landmarks, n))
    pattern = pattern_of_edges(sizes, pairs)
    name, order = _find_order(ordering, n, pairs, first, pattern)

    counts = _core.count_factor(*pattern, order)
    below: NDArray[np.int64] = counts["blocks_below"]
    if record_steps is not None:
        record_steps = as_flag("record_steps", record_steps)
    else:
        record_steps = int((below * below).sum()) <= 2 * MOST_PAIRS_TO_RECORD
    edge_list = tuple((a, b) for a, b in pairs.tolist())
    ordered, block_sizes = tuple(order.tolist()), tuple(sizes.tolist())
    wide = sizes.astype(np.int64)
    return GraphInspection(
        num_variables=n,
        names=labels,
        edges=edge_list,
        ordering=name,
        order=ordered,
        steps=eliminate(edge_list, block_sizes, ordered) if record_steps else (),
        column_counts=tuple(below.tolist()),
        fill=counts["fill_edges"],
        flops=int(counts["flops"]),
        cholmod_flops=int(counts["cholmod_flops"]),
        nnz=int((wide * wide).sum() + 2 * (wide[pairs[:, 0]] * wide[pairs[:, 1]]).sum()),
        nnz_factor=int(counts["entries"]),
        tree_height=counts["tree_height"],
        block_sizes=block_sizes,
        landmarks=tuple(first.tolist()),
    )


def pattern_of_edges(
    sizes: NDArray[np.int32], pairs: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]:
    """Return the lower triangle by block columns; pairs (smaller, larger), each once."""
    diagonal = np.arange(len(sizes))
    columns = np.concatenate([diagonal, pairs[:, 0]])
    rows = np.concatenate([diagonal, pairs[:, 1]])
    by_column = np.lexsort((rows, columns))
    begin = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=len(sizes)))])
    return sizes, begin.astype(np.int64), rows[by_column].astype(np.int32)


def _find_order(
    ordering: str | Sequence[int],
    num_variables: int,
    pairs: NDArray[np.int64],
    landmarks: NDArray[np.int64],
    pattern: tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]],
) -> tuple[str, NDArray[np.int32]]:
    """Return an order and its name."""
    if not isinstance(ordering, str):
        return "given", as_variables("ordering", ordering, num_variables).astype(np.int32)
    name = choice("ordering", ordering, GRAPH_ORDERINGS)
    if name == "landmarks_first":
        if len(landmarks) == 0:
            raise InputError("ordering landmarks_first: expected landmarks, found none")
        others = np.setdiff1d(np.arange(num_variables), landmarks)
        return name, np.concatenate([landmarks, others]).astype(np.int32)
    if name == "minimum_degree":
        edges = ((a, b) for a, b in pairs.tolist())
        return name, np.array(minimum_degree_order(num_variables, edges), np.int32)
    return name, _core.order_blocks(*pattern, name)
