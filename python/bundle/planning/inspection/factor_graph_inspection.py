"""Structure of a factor graph, the cost of factorising its normal equations, and a step's time.

Two variables have a block in Lambda = J^T J if a factor joins them. A factor of k variables
therefore adds all k (k - 1) / 2 pairs: a prior from a marginalisation makes its variables dense.
Constant coordinates have no columns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.interface.tabular import Tabular
from bundle.planning.inspection.elimination_costs import (
    EliminationCost,
    advise,
    display_of,
    elimination_costs,
    with_time,
)
from bundle.planning.inspection.factor_graph_time import factor_work, step_terms
from bundle.planning.inspection.machine_rates import factor_graph_rates
from bundle.planning.inspection.peak_memory import Terms

MOST_DENSE_COLUMNS = 100
"""Free coordinates up to which a solve takes a dense matrix (``cpp/core/ceres/solve_graph.cpp``).
"""

TAKEN = ("amd", "dense")
"""Orders that Ceres offers for a factor graph: AMD of a sparse matrix, or a dense matrix."""


@dataclass(frozen=True, kw_only=True, repr=False)
class FactorGraphInspection(Displayed, Tabular):
    """Normal equations of a factor graph and the cost of factorising them.

    Attributes:
        num_variables: number of variables.
        num_factors: number of factors.
        manifolds: number of variables by manifold.
        kinds: number of factors by class.
        num_columns: number of free coordinates.
        num_free_variables: variables with a free coordinate; the costs are for these.
        num_edges: distinct pairs of free variables with a common factor.
        largest_clique: free variables of the factor with most of them.
        nnz: nonzeros of Lambda over the free coordinates, both triangles and the diagonal.
        density: share of nonzeros in that matrix.
        costs: one per order, then the dense matrix.
        auto_ordering: order that a solve selects.
        num_threads: threads of the predicted times, which are of Ceres' normal equations with the
            evaluation of this graph's factors. Times are NaN if a factor failed.
    """

    num_variables: int
    num_factors: int
    manifolds: dict[str, int]
    kinds: dict[str, int]
    num_columns: int
    num_free_variables: int
    num_edges: int
    largest_clique: int
    nnz: int
    density: float
    costs: tuple[EliminationCost, ...]
    auto_ordering: str
    num_threads: int

    @property
    def recommendation(self) -> str:
        """Advice on the order, in one sentence."""
        if self.auto_ordering == "dense":
            unknowns = plural(self.num_columns, "free coordinate")
            return f"A solve takes dense matrices, which are the fastest for {unknowns}."
        return advise(self.costs, self.auto_ordering, "")

    def _display(self) -> Display:
        counts = f"{plural(self.num_variables, 'variable')}, {plural(self.num_factors, 'factor')}"
        return display_of(self, "Lambda", counts)


def inspect_factor_graph(
    graph: FactorGraph, num_threads: int = 0, *, recalibrate: bool = False
) -> FactorGraphInspection:
    """Count the cost of a step of a factor graph's solve; see :func:`bundle.inspect`.

    A sample of the factors is evaluated, which calls functions in Python.
    """
    graph.check_free()
    variables, factors = graph.variables, graph.factors
    sizes = np.array([len(v.coordinates) - sum(v.held) for v in variables.values()], np.int32)
    pairs, largest = _pairs(graph, sizes > 0)
    free = sizes[sizes > 0]
    wide = free.astype(np.int64)
    nnz = int((wide**2).sum() + 2 * (wide[pairs[:, 0]] * wide[pairs[:, 1]]).sum())
    columns = int(wide.sum())
    threads = min(num_threads or _core.hardware_threads(), _core.hardware_threads())
    predict = _prediction(graph, threads, recalibrate)
    *sparse, dense = elimination_costs(
        free, pairs, TAKEN, lambda _pattern, _order, counts: predict(counts)
    )
    return FactorGraphInspection(
        num_variables=len(variables),
        num_factors=len(factors),
        manifolds=dict(Counter(variable.manifold for variable in variables.values())),
        kinds=dict(Counter(type(factor).__name__ for factor in factors)),
        num_columns=columns,
        num_free_variables=len(free),
        num_edges=len(pairs),
        largest_clique=largest,
        nnz=nnz,
        density=nnz / columns**2,
        costs=(*sparse, with_time(dense, predict({"columns": columns}))),
        auto_ordering="dense" if columns <= MOST_DENSE_COLUMNS else "amd",
        num_threads=threads,
    )


def _prediction(
    graph: FactorGraph, num_threads: int, recalibrate: bool
) -> Callable[[Mapping[str, Any]], Terms]:
    """Return a function from counts to the parts of a step's time: none if a factor fails."""
    try:
        work = factor_work(graph)
    except Exception:  # of a user's function; the structure is known without it
        return lambda _: {}
    rates = factor_graph_rates(recalibrate=recalibrate)
    return lambda counts: step_terms(rates, work, counts, num_threads)


def _pairs(graph: FactorGraph, is_free: NDArray[np.bool_]) -> tuple[NDArray[np.int64], int]:
    """Return distinct pairs of free variables with a common factor, and the largest clique."""
    free = [key for key, flag in zip(graph.keys, is_free, strict=True) if flag]
    place = {key: k for k, key in enumerate(free)}
    cliques = {
        tuple(sorted(place[key] for key in factor.keys if key in place)) for factor in graph.factors
    }
    count = len(free)
    codes = {a * count + b for clique in cliques for a, b in combinations(clique, 2)}
    first, second = np.divmod(np.array(sorted(codes), np.int64), count)
    return np.stack([first, second], axis=1), max(map(len, cliques))
