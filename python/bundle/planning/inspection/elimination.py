"""Variable elimination on a small graph, with the neighbours and the fill-in of each step.

The graph of a symmetric matrix has one vertex per variable and one edge per pair of variables whose
block is nonzero. Eliminating a variable makes its neighbours a clique. Each new edge is fill-in: an
entry of the Cholesky factor L where the matrix has a zero. The variable's column of L has one block
for each neighbour at that step.

This file implements the definition. For real problems ``_core.count_factor`` computes the same
counts without creating edges (``cpp/core/symbolic/factor_counts.cpp``); tests compare the two.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from itertools import combinations

from bundle.base.records import dataclass

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
