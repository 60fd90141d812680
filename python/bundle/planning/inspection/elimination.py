"""Eliminating a small graph one variable at a time, with everything that happens on the way.

The graph of a symmetric matrix has a vertex a variable and an edge a pair of variables whose block
is not zero. Eliminating a variable from the linear system joins all its neighbours to each other:
each edge this creates is fill, an entry of the Cholesky factor L where the matrix has none. The
variable's column of L holds its neighbours at that moment.

This is the definition, step by step; what real sizes need is counted by ``_core.count_factor``
without creating an edge (``cpp/core/symbolic/factor_counts.cpp``), and tests hold the two together.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

__all__ = ["EliminationStep", "eliminate", "minimum_degree_order"]

Edge = tuple[int, int]


@dataclass(frozen=True)
class EliminationStep:
    """The elimination of one variable.

    Attributes:
        variable: the one eliminated.
        neighbours: those it met, which were left; ascending.
        fill: pairs of neighbours that had not met and now do; ascending.
        flops: of this step, c^2 + 3 c summed over the variable's scalar columns, c the entries
            below the diagonal.
        total_fill: fill edges up to and with this step.
        total_flops: flops up to and with this step.
    """

    variable: int
    neighbours: tuple[int, ...]
    fill: tuple[Edge, ...]
    flops: int
    total_fill: int
    total_flops: int


class _Graph:
    """What is left of a graph as its variables go."""

    def __init__(self, num_variables: int, edges: Iterable[Edge]) -> None:
        self.neighbours: list[set[int]] = [set() for _ in range(num_variables)]
        for a, b in edges:
            self.neighbours[a].add(b)
            self.neighbours[b].add(a)

    def eliminate(self, variable: int) -> tuple[tuple[int, ...], tuple[Edge, ...]]:
        """Take a variable out; return its neighbours and the edges created."""
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
    """Eliminate the variables in ``order``, a permutation; one block size a variable."""
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
    """Return the exact greedy order: always a variable with the fewest neighbours left.

    Of several the one with the smallest index. AMD and COLAMD bound the number of neighbours
    instead of counting it, which is why they are fast.
    """
    graph = _Graph(num_variables, edges)
    left = set(range(num_variables))
    # Every change of a degree is pushed; an entry that is no longer true is passed over.
    queue = [(len(graph.neighbours[variable]), variable) for variable in left]
    heapq.heapify(queue)
    order: list[int] = []
    while queue:
        degree, variable = heapq.heappop(queue)
        if variable not in left or degree != len(graph.neighbours[variable]):
            continue
        if degree == len(left) - 1:  # all that are left meet each other, and will
            return (*order, *sorted(left))
        order.append(variable)
        left.remove(variable)
        neighbours, _ = graph.eliminate(variable)
        for neighbour in neighbours:
            heapq.heappush(queue, (len(graph.neighbours[neighbour]), neighbour))
    return tuple(order)
