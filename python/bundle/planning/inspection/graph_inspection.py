"""``inspect_graph``: count fill-in and flops of a graph's elimination, without numerical work."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arguments import as_flag
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError
from bundle.interface.inspect_options import GRAPH_ORDERINGS
from bundle.interface.option_fields import choice
from bundle.interface.tabular import Tabular
from bundle.planning.inspection.elimination import EliminationStep, eliminate, minimum_degree_order
from bundle.planning.inspection.graph_input import (
    as_block_sizes,
    as_edges,
    as_names,
    as_variables,
)

# Largest number of neighbour pairs for which steps are recorded by default. This takes about a
# second: some hundred variables, or thousands with little fill-in.
MOST_PAIRS_TO_RECORD = 2_000_000


@dataclass(frozen=True, repr=False)
class GraphInspection(Displayed, Tabular):
    """Symbolic Cholesky factor L of a matrix with a given graph.

    Nonzeros of the matrix count both triangles and the diagonal; those of L count its lower
    triangle with the diagonal. A variable is a full block of ``block_sizes`` scalars.

    Attributes:
        num_variables: vertices of the graph.
        names: names of the variables.
        edges: adjacent variables (smaller, larger), ascending, each pair once.
        ordering: name of the elimination order; "given" for a permutation.
        order: ``order[k]`` is the k-th eliminated variable.
        steps: elimination steps; empty if not recorded.
        column_counts: (num_variables,) in elimination order: blocks below the diagonal of L, one
            per remaining neighbour.
        fill: fill-in edges.
        flops: sum of c^2 + 3 c over the scalar columns of L with c entries below the diagonal.
            Eliminating a column updates c (c + 1) / 2 entries of a triangle and c entries of the
            right-hand side by one multiplication and one subtraction each.
        cholmod_flops: sum of (c + 1)^2, as CHOLMOD's analysis reports it (``fl``).
        nnz: nonzeros of the matrix.
        nnz_factor: nonzeros of L.
        tree_height: variables on the longest path of the elimination tree; their eliminations are
            sequential.
        block_sizes: scalars of each variable.
        landmarks: variables that ``landmarks_first`` eliminates first.
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
        """Number of scalar columns of the matrix."""
        return sum(self.block_sizes)

    @property
    def density(self) -> float:
        """Share of the matrix entries that are nonzero."""
        return self.nnz / max(1, self.num_columns) ** 2

    @cached_property
    def scalar_column_counts(self) -> tuple[int, ...]:
        """Entries below the diagonal of L, (num_columns,) in elimination order."""
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
        """Return (sizes, column_begin, rows): the lower triangle in the core's format."""
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
    """Eliminate the variables of a graph in a given order and count fill-in and flops.

    Orders: "natural" and "reverse" by index; "landmarks_first" eliminates ``landmarks`` and then
    the other variables, both by index; "minimum_degree" eliminates a variable with the fewest
    remaining neighbours, ties by index; "amd", "colamd", "metis" and "nesdis" are CHOLMOD's.

    Args:
        edges: (num_edges, 2) pairs of adjacent variables. Repeated and reversed edges count once.
        num_variables: number of variables; by default the number of names, or one more than the
            largest index in an edge.
        ordering: one of ``GRAPH_ORDERINGS``, in upper or lower case, with hyphens or underscores,
            or a permutation of all variables.
        names: names of the variables; by default their indices.
        landmarks: indices of the landmarks.
        block_size: scalars of each variable, such as 6 for poses: one number, or one per variable.
        record_steps: True to record every step; by default steps are recorded if that is fast.

    Raises:
        InputError: an edge joins a variable to itself, an index is out of range, an order is not a
            permutation, or another argument is invalid.
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
    """Return the lower triangle by block columns of distinct pairs (smaller, larger)."""
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
    """Return the name of an order and its permutation."""
    if not isinstance(ordering, str):
        return "given", as_variables("ordering", ordering, num_variables).astype(np.int32)
    name = choice("ordering", ordering, GRAPH_ORDERINGS)
    if name == "landmarks_first":
        if len(landmarks) == 0:
            raise InputError("ordering landmarks_first: expected at least one landmark, found 0")
        others = np.setdiff1d(np.arange(num_variables), landmarks)
        return name, np.concatenate([landmarks, others]).astype(np.int32)
    if name == "minimum_degree":
        edges = ((a, b) for a, b in pairs.tolist())
        return name, np.array(minimum_degree_order(num_variables, edges), np.int32)
    return name, _core.order_blocks(*pattern, name)
