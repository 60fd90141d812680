"""``inspect_graph``: count fill-in and flops of a graph's elimination, without numerical work.

The graph of a symmetric matrix has one vertex per variable and one edge per pair of variables whose
block is nonzero. Eliminating a variable makes its neighbours a clique. Each new edge is fill-in: an
entry of the Cholesky factor L where the matrix has a zero. The variable's column of L has one block
for each neighbour at that step.

This file implements the definition. For real problems ``_core.count_factor`` computes the same
counts without creating edges (``cpp/core/symbolic/factor_counts.cpp``); tests compare the two.

Users give graphs as arguments, or as text files with one edge per line.
"""

from __future__ import annotations

import heapq
import operator
import os
import re
from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import as_flag, as_integers, check_shape, refuse_row
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.errors import InputError, brief, shown
from bundle.interface.option_fields import choice
from bundle.interface.planning_options import GRAPH_ORDERINGS
from bundle.interface.tabular import Tabular
from bundle.planning.inspection.problem_pattern import BlockPattern, pattern_of_edges

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

    def pattern(self) -> BlockPattern:
        """Return the lower triangle."""
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
        nnz=pattern.nnz,
        nnz_factor=int(counts["entries"]),
        tree_height=counts["tree_height"],
        block_sizes=block_sizes,
        landmarks=tuple(first.tolist()),
    )


def _find_order(
    ordering: str | Sequence[int],
    num_variables: int,
    pairs: NDArray[np.int64],
    landmarks: NDArray[np.int64],
    pattern: BlockPattern,
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


Edge = tuple[int, int]


@dataclass(frozen=True)
class EliminationStep:
    """Elimination of one variable.

    Attributes:
        variable: the eliminated variable.
        neighbours: its remaining neighbours, ascending.
        fill: fill-in: pairs of neighbours that become adjacent, ascending.
        flops: flops of this step: c^2 + 3 c summed over the variable's scalar columns, with c
            entries below the diagonal.
        total_fill: fill-in edges up to and including this step.
        total_flops: flops up to and including this step.
    """

    variable: int
    neighbours: tuple[int, ...]
    fill: tuple[Edge, ...]
    flops: int
    total_fill: int
    total_flops: int


class _Graph:
    """Graph of the variables that are not yet eliminated."""

    def __init__(self, num_variables: int, edges: Iterable[Edge]) -> None:
        self.neighbours: list[set[int]] = [set() for _ in range(num_variables)]
        for a, b in edges:
            self.neighbours[a].add(b)
            self.neighbours[b].add(a)

    def eliminate(self, variable: int) -> tuple[tuple[int, ...], tuple[Edge, ...]]:
        """Eliminate a variable; return its neighbours and the fill-in edges."""
        neighbours = tuple(sorted(self.neighbours[variable]))
        fill = tuple((a, b) for a, b in combinations(neighbours, 2) if b not in self.neighbours[a])
        for a, b in fill:
            self.neighbours[a].add(b)
            self.neighbours[b].add(a)
        for neighbour in neighbours:
            self.neighbours[neighbour].remove(variable)
        self.neighbours[variable].clear()
        return neighbours, fill


def eliminate(
    edges: Iterable[Edge], block_sizes: Sequence[int], order: Iterable[int]
) -> tuple[EliminationStep, ...]:
    """Eliminate the variables in ``order``, a permutation; one block size per variable."""
    graph = _Graph(len(block_sizes), edges)
    steps: list[EliminationStep] = []
    total_fill = total_flops = 0
    for variable in order:
        neighbours, fill = graph.eliminate(variable)
        below = sum(block_sizes[neighbour] for neighbour in neighbours)
        flops = sum(c * c + 3 * c for c in range(below, below + block_sizes[variable]))
        total_fill += len(fill)
        total_flops += flops
        steps.append(EliminationStep(variable, neighbours, fill, flops, total_fill, total_flops))
    return tuple(steps)


def minimum_degree_order(num_variables: int, edges: Iterable[Edge]) -> tuple[int, ...]:
    """Return the exact minimum degree order: always a variable with the fewest neighbours left.

    Ties go to the smallest index. AMD and COLAMD are fast because they bound the number of
    neighbours instead of counting it.
    """
    graph = _Graph(num_variables, edges)
    left = set(range(num_variables))
    # Every change of a degree is pushed; stale entries are skipped.
    queue = [(len(graph.neighbours[variable]), variable) for variable in left]
    heapq.heapify(queue)
    order: list[int] = []
    while queue:
        degree, variable = heapq.heappop(queue)
        if variable not in left or degree != len(graph.neighbours[variable]):
            continue
        if degree == len(left) - 1:  # the remaining variables form a clique
            return (*order, *sorted(left))
        order.append(variable)
        left.remove(variable)
        neighbours, _ = graph.eliminate(variable)
        for neighbour in neighbours:
            heapq.heappush(queue, (len(graph.neighbours[neighbour]), neighbour))
    return tuple(order)


@dataclass(frozen=True)
class GraphFile:
    """Graph whose variables are numbered from 0."""

    # names of the variables: integers in ascending order, other names in file order
    names: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]  # pairs of variables in file order
    landmarks: tuple[int, ...]  # variables with names such as l17 or L17, as GTSAM names landmarks


def load_graph(path: str | os.PathLike[str]) -> GraphFile:
    """Read edges "a b", one per line; a line with one name declares a variable.

    Spaces or commas separate names. Text after # or % is a comment. A repeated edge counts once.
    """
    lines: list[list[str]] = []
    for number, raw in enumerate(Path(path).read_bytes().splitlines(), start=1):
        where = f"{shown(path)}:{number}"
        try:
            text = raw.decode("utf-8-sig" if number == 1 else "utf-8")
        except UnicodeDecodeError as error:
            raise InputError(
                f"{where}: expected UTF-8 text, found byte 0x{raw[error.start]:02x}"
            ) from None
        names = re.split("[#%]", text, maxsplit=1)[0].replace(",", " ").split()
        if len(names) > 2:
            found = shown(" ".join(names))
            raise InputError(
                f"{where}: expected one or two variables, found {len(names)}: {found:.60}"
            )
        if len(names) == 2 and names[0] == names[1]:
            raise InputError(
                f"{where}: expected two different variables, found {shown(names[0])} twice"
            )
        lines.append(names)
    return _number(lines)


def _number(lines: list[list[str]]) -> GraphFile:
    found = dict.fromkeys(name for names in lines for name in names)
    if all(re.fullmatch(r"-?[0-9]{1,18}", name) for name in found):
        names = tuple(sorted(found, key=lambda name: (int(name), name)))
    else:
        names = tuple(found)
    number = {name: variable for variable, name in enumerate(names)}
    edges = tuple((number[line[0]], number[line[1]]) for line in lines if len(line) == 2)
    landmarks = tuple(v for v, name in enumerate(names) if re.fullmatch("[lL][0-9]+", name))
    return GraphFile(names, edges, landmarks)


MOST_VARIABLES = 2**31 - 2
MOST_SCALARS_A_BLOCK = 2**31 - 1


def as_edges(edges: Any) -> NDArray[np.int64]:
    """Return the edges as (num_edges, 2); refuse loops."""
    pairs = as_integers("edges", edges)
    if pairs.size == 0:
        return np.zeros((0, 2), np.int64)
    check_shape("edges", pairs, ("num_edges", 2))
    refuse_row(
        pairs[:, 0] == pairs[:, 1],
        lambda k: f"edge {k}: expected two variables, found {pairs[k, 0]} twice",
    )
    return pairs


def as_names(
    names: Sequence[str] | None, pairs: NDArray[np.int64], num_variables: int | None
) -> tuple[str, ...]:
    """Return one name per variable."""
    listed = isinstance(names, str | list | tuple) or (
        isinstance(names, np.ndarray) and names.ndim == 1
    )
    if names is not None and not listed:
        raise InputError(f"names: expected a list of names, found {brief(names)}")
    if num_variables is None:
        num_variables = len(names) if names is not None else int(pairs.max(initial=-1)) + 1
    try:
        count = operator.index(num_variables)
    except TypeError:
        raise InputError(
            f"num_variables: expected an integer, found {brief(num_variables)}"
        ) from None
    if not 0 <= count <= MOST_VARIABLES:
        raise InputError(f"num_variables: expected 0 to {MOST_VARIABLES}, found {count}")
    if names is None:
        return tuple(map(str, range(count)))
    if len(names) != count:
        raise InputError(f"names: expected {count} names, one per variable, found {len(names)}")
    return tuple(map(str, names))


def as_variables(
    argument: str, values: Iterable[Any] | NDArray[np.int64], num_variables: int
) -> NDArray[np.int64]:
    """Return indices of variables; refuse indices out of range."""
    variables = as_integers(argument, values)
    expected = f"variables 0 to {num_variables - 1}" if num_variables else "no variables"
    refuse_row(
        (variables < 0) | (variables >= num_variables),
        lambda k: f"{argument}: expected {expected}, found {variables.flat[k]}",
    )
    return variables


def as_block_sizes(block_size: int | Sequence[int], num_variables: int) -> NDArray[np.int32]:
    """Return the number of scalars of each variable."""
    one = isinstance(block_size, int | np.integer)
    sizes = as_integers("block_size", [block_size] if one else block_size)
    if one:
        sizes = np.full(num_variables, sizes[0])
    if sizes.shape != (num_variables,):
        raise InputError(
            f"block_size: expected one size, or {num_variables} sizes, one per variable, found "
            f"{sizes.shape}"
        )
    refuse_row(
        (sizes < 1) | (sizes > MOST_SCALARS_A_BLOCK),
        lambda k: f"block_size: expected 1 to {MOST_SCALARS_A_BLOCK}, found {sizes[k]}",
    )
    return sizes.astype(np.int32)
