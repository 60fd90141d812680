"""Cost of the Cholesky factor of a block-sparse matrix, under each elimination order and dense.

Conventions of all inspections. Nonzeros of a matrix count both triangles and the diagonal; those of
its factor L, nnz(L), count the lower triangle with the diagonal. A block counts as full. Flops are
the sum of c^2 + 3 c over the columns of L with c entries below the diagonal
(``cpp/core/symbolic/factor_counts.h``).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.display import Display
from bundle.base.records import dataclass
from bundle.base.words import number, span
from bundle.planning.inspection.graph_inspection import pattern_of_edges
from bundle.planning.inspection.peak_memory import Terms, total
from bundle.planning.inspection.problem_pattern import count_dense

CONVENTION = (
    "Nonzeros count both triangles and the diagonal; those of the factor L, its lower triangle "
    "with the diagonal."
)

ORDERINGS = ("natural", "amd", "metis", "colamd", "nesdis")
"""Orders of an inspection; of these a solve offers some."""

BYTES = 8

Pattern = tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]
Predict = Callable[[Pattern, NDArray[np.int32], Mapping[str, Any]], Terms]


@dataclass(frozen=True, kw_only=True)
class EliminationCost:
    """Exact cost of the Cholesky factor L in one order of the variables.

    Attributes:
        ordering: "natural" (by position), "amd", "metis", "colamd", "nesdis", or "dense" for a
            dense matrix.
        nnz_factor: nnz(L): lower triangle with its diagonal, without the zeros that supernodes
            store.
        fill: fill-in: pairs of variables that are nonzero in L and zero in the matrix.
        flops: sum of c^2 + 3 c over the columns of L with c entries below the diagonal.
        tree_height: variables on the longest path of the elimination tree.
        memory_in_bytes: memory of the values of L, of a dense matrix with both triangles.
        is_taken: True if an option of the solve selects the order.
        time_per_step_in_seconds: predicted time of a step with this order; NaN if unknown.
        time_terms: parts of this time.
    """

    ordering: str
    nnz_factor: int
    fill: int
    flops: int
    tree_height: int
    memory_in_bytes: int
    is_taken: bool = True
    time_per_step_in_seconds: float = math.nan
    time_terms: Mapping[str, float] = field(default_factory=dict)


def elimination_costs(
    sizes: NDArray[np.int32],
    pairs: NDArray[np.int64],
    taken: Sequence[str],
    predict: Predict | None = None,
) -> tuple[EliminationCost, ...]:
    """Return the cost of each order, then of the dense matrix.

    ``sizes``: (n,) scalars of each variable. ``pairs``: distinct pairs (smaller, larger) of
    variables with a nonzero block. ``predict``: function from pattern, order and
    ``_core.count_factor`` to the parts of a step's time; None: unknown.
    """
    pattern = pattern_of_edges(sizes, pairs)
    costs = []
    for name in ORDERINGS:
        order = _core.order_blocks(*pattern, name)
        counts: dict[str, Any] = _core.count_factor(*pattern, order)
        terms = {} if predict is None else predict(pattern, order, counts)
        cost = EliminationCost(
            ordering=name,
            nnz_factor=int(counts["entries"]),
            fill=int(counts["fill_edges"]),
            flops=int(counts["flops"]),
            tree_height=int(counts["tree_height"]),
            memory_in_bytes=BYTES * int(counts["entries"]),
            is_taken=name in taken,
        )
        costs.append(with_time(cost, terms))
    n, columns = len(sizes), int(sizes.sum(dtype=np.int64))
    dense = count_dense(columns, n * (n - 1) // 2 - len(pairs), n)
    return (
        *costs,
        EliminationCost(
            ordering="dense",
            nnz_factor=int(dense.nnz),
            fill=int(dense.fill),
            flops=int(dense.flops),
            tree_height=n,
            memory_in_bytes=BYTES * columns**2,
            is_taken="dense" in taken,
        ),
    )


def display_of(found: Any, matrix: str, counts: str) -> Display:
    """Return the display of a graph's inspection, with the name of its matrix."""
    facts = [
        (matrix, f"{found.nnz} nonzeros, {100 * found.density:.4g} %"),
        *(
            (
                cost.ordering,
                f"{cost.nnz_factor} nonzeros of L, {number(cost.flops)} flops, "
                f"{span(cost.time_per_step_in_seconds)} per step",
            )
            for cost in found.costs
        ),
        ("advice", found.recommendation),
    ]
    return Display(title=f"{type(found).__name__}: {counts}", facts=tuple(facts))


def with_time(cost: EliminationCost, terms: Terms) -> EliminationCost:
    """Return the cost with the parts of a predicted time; unchanged without parts."""
    if not terms:
        return cost
    return dataclasses.replace(cost, time_per_step_in_seconds=total(terms), time_terms=terms)


def advise(costs: Sequence[EliminationCost], chosen: str, setting: str) -> str:
    """Return advice on the order in a sentence.

    ``setting``: option that should stay at its default; "" without an option.
    """
    flops = {cost.ordering: cost.flops for cost in costs if cost.is_taken}
    least = min(flops, key=lambda name: flops[name])
    worst = max(flops, key=lambda name: flops[name])
    words = f"Leave {setting}: it selects {chosen}, " if setting else f"A solve takes {chosen}, "
    if flops[worst] > flops[chosen]:
        against = "a dense matrix" if worst == "dense" else "the worst order"
        words += f"{number(flops[worst] / max(flops[chosen], 1))} times fewer flops than {against}"
    else:
        words += "and all orders cost the same"
    if flops[least] < flops[chosen]:
        share = 100 - round(100 * flops[least] / flops[chosen])
        words += f" ({least} needs {share} % fewer, but computing it takes longer than it saves)"
    return words + "."
