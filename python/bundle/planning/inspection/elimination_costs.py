"""Cost of a step of a pose graph or a factor graph, under each elimination order and dense.

Conventions of all inspections. Nonzeros of a matrix count both triangles and the diagonal; those of
its factor L, nnz(L), count the lower triangle with the diagonal. A block counts as full. Flops are
the sum of c^2 + 3 c over the columns of L with c entries below the diagonal
(``cpp/core/symbolic/factor_counts.h``).

Two variables of a factor graph have a block in Lambda = J^T J if a factor joins them. A factor of k
variables therefore adds all k (k - 1) / 2 pairs: a prior from a marginalisation makes its variables
dense. Constant coordinates have no columns.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import bundle._core as _core
from bundle.base.arrays import check_type
from bundle.base.display import Display, Displayed
from bundle.base.paths import as_path, is_path
from bundle.base.records import dataclass
from bundle.base.words import number, plural, span
from bundle.graphs.factors.factor_graph import FactorGraph
from bundle.graphs.factors.factor_graph import free_pattern as pattern_of_factors
from bundle.graphs.pose_graphs.edge_weights import check_free_pose
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.tabular import Tabular
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.inspection.factor_graph_time import factor_graph_rates, factor_work
from bundle.planning.inspection.factor_graph_time import step_terms as factor_step_terms
from bundle.planning.inspection.inspection_result import EliminationCost
from bundle.planning.inspection.peak_memory import Terms, total
from bundle.planning.inspection.pose_graph_time import (
    free_pattern,
    panel_work,
    pose_graph_rates,
    step_terms,
)
from bundle.planning.inspection.problem_pattern import BlockPattern, count_dense

CONVENTION = (
    "Nonzeros count both triangles and the diagonal; those of the factor L, its lower triangle "
    "with the diagonal."
)

ORDERINGS = ("natural", "amd", "metis", "colamd", "nesdis")
"""Orders of an inspection; of these a solve offers some."""

OF_POSES, OF_FACTORS = ("natural", "amd", "metis"), ("amd", "dense")
"""Orders that a solve offers for a pose graph, and Ceres for a factor graph."""

MOST_DENSE_COLUMNS = 100
"""Free coordinates up to which a solve takes a dense matrix (``cpp/core/ceres/solve_graph.cpp``).
"""

BYTES = 8

Predict = Callable[[BlockPattern, NDArray[np.int32], Mapping[str, Any]], Terms]


def elimination_costs(
    pattern: BlockPattern, taken: Sequence[str], predict: Predict
) -> tuple[EliminationCost, ...]:
    """Return the cost of each order, then of the dense matrix.

    ``predict``: function from pattern, order and ``_core.count_factor`` to the parts of a step's
    time.
    """
    costs = []
    for name in ORDERINGS:
        order = _core.order_blocks(*pattern, name)
        counts: dict[str, Any] = _core.count_factor(*pattern, order)
        cost = EliminationCost(
            ordering=name,
            nnz_factor=int(counts["entries"]),
            fill=int(counts["fill_edges"]),
            flops=int(counts["flops"]),
            tree_height=int(counts["tree_height"]),
            memory_in_bytes=BYTES * int(counts["entries"]),
            is_taken=name in taken,
        )
        costs.append(with_time(cost, predict(pattern, order, counts)))
    n, columns = len(pattern.sizes), pattern.num_columns
    dense = count_dense(columns, n * (n - 1) // 2 - pattern.num_edges, n)
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


@dataclass(frozen=True, kw_only=True, repr=False)
class FactorGraphInspection(Displayed, Tabular):
    """Normal equations of a pose graph or a factor graph and the cost of factorising them.

    Attributes:
        num_variables: number of variables, or of poses.
        num_factors: number of factors, or of edges.
        manifolds: number of variables by manifold.
        kinds: number of factors by class.
        block_size: 3 for a pose graph in 2D (SE(2)), 6 in 3D (SE(3)); 0 if variables have
            sizes of their own.
        num_columns: number of free coordinates.
        num_free_variables: variables with a free coordinate; the costs are for these.
        num_edges: distinct pairs of poses with an edge, or of free variables with a common factor.
        largest_clique: largest number of free variables of one factor.
        nnz: nonzeros of the information matrix, both triangles and the diagonal: over all poses of
            a pose graph, over the free coordinates of a factor graph.
        nnz_free: its nonzeros over the free coordinates.
        density: share of nonzeros in the matrix of ``nnz``.
        costs: one per order, then the dense matrix.
        auto_ordering: order that a solve selects; for a pose graph, with ``auto``.
        num_threads: threads of the predicted times. The times of a factor graph are those of
            Ceres' normal equations and of its factors; NaN if a factor failed.
    """

    num_variables: int
    num_factors: int
    manifolds: dict[str, int]
    kinds: dict[str, int]
    block_size: int = 0
    num_columns: int
    num_free_variables: int
    num_edges: int
    largest_clique: int
    nnz: int
    nnz_free: int
    density: float
    costs: tuple[EliminationCost, ...]
    auto_ordering: str
    num_threads: int

    @property
    def num_poses(self) -> int:
        """Number of poses of a pose graph."""
        return self.num_variables

    @property
    def num_free_poses(self) -> int:
        """Number of poses that a solve does not hold constant."""
        return self.num_free_variables

    @property
    def recommendation(self) -> str:
        """Recommended order and the reason, in one sentence."""
        if self.auto_ordering == "dense":
            unknowns = plural(self.num_columns, "free coordinate")
            return f"Dense matrices are the fastest for {unknowns}: a solve uses them."
        setting = "--pose-ordering at auto" if self.block_size else ""
        return advise(self.costs, self.auto_ordering, setting)

    def _display(self) -> Display:
        counts = f"{plural(self.num_variables, 'variable')}, {plural(self.num_factors, 'factor')}"
        if self.block_size:
            counts = f"{plural(self.num_variables, 'pose')}, {plural(self.num_edges, 'edge')}"
        facts = [
            ("matrix", f"{self.nnz} nonzeros, {100 * self.density:.4g} %"),
            *(
                (
                    cost.ordering,
                    f"{cost.nnz_factor} nonzeros of L, {number(cost.flops)} flops, "
                    f"{span(cost.time_per_step_in_seconds)} per step",
                )
                for cost in self.costs
            ),
            ("advice", self.recommendation),
        ]
        return Display(title=f"FactorGraphInspection: {counts}", facts=tuple(facts))


PoseGraphInspection = FactorGraphInspection
"""Name of the inspection of a pose graph."""


def inspect_pose_graph(
    source: Any, num_threads: int = 0, *, recalibrate: bool = False
) -> FactorGraphInspection:
    """Count the cost of a step of a pose graph's solve; see :func:`bundle.inspect`.

    ``num_threads``: number of threads of the predicted solve; 0: all cores.
    """
    if isinstance(source, PoseGraphResult):
        source = source.problem
    elif is_path(source):
        source = load_g2o(as_path(source))
    check_type("graph", source, PoseGraph)
    graph: PoseGraph = source
    check_free_pose(graph)
    d = graph.tangent_size
    held, _, _ = _core.hold_poses(graph)
    num_edges = len(np.unique(np.sort(graph.edges, axis=1), axis=0))
    pattern = free_pattern(graph)
    threads = min(num_threads or _core.hardware_threads(), _core.hardware_threads())
    rates = pose_graph_rates(threads, recalibrate=recalibrate)
    nnz = d * d * (graph.num_poses + 2 * num_edges)
    return FactorGraphInspection(
        num_variables=graph.num_poses,
        num_factors=graph.num_edges,
        manifolds={f"se{graph.dimension}": graph.num_poses},
        kinds={"BetweenFactor": graph.num_edges},
        block_size=d,
        num_columns=pattern.num_columns,
        num_free_variables=len(pattern.sizes),
        num_edges=num_edges,
        largest_clique=2 if pattern.num_edges else 1,
        nnz=nnz,
        nnz_free=pattern.nnz,
        density=nnz / (d * graph.num_poses) ** 2,
        costs=elimination_costs(
            pattern,
            OF_POSES,
            lambda pattern, order, _: step_terms(rates, graph, panel_work(pattern, order, threads)),
        ),
        auto_ordering=_core.auto_ordering(graph, held),
        num_threads=threads,
    )


def inspect_factor_graph(
    graph: FactorGraph, num_threads: int = 0, *, recalibrate: bool = False
) -> FactorGraphInspection:
    """Count the cost of a step of a factor graph's solve; see :func:`bundle.inspect`.

    A sample of the factors is evaluated, which calls functions in Python.
    """
    graph.check_free()
    variables, factors = graph.variables, graph.factors
    pattern = BlockPattern(*pattern_of_factors(variables, factors))
    columns, nnz = pattern.num_columns, pattern.nnz
    is_free = {key: sum(v.held) < len(v.coordinates) for key, v in variables.items()}
    threads = min(num_threads or _core.hardware_threads(), _core.hardware_threads())
    predict = _prediction(graph, threads, recalibrate)
    *sparse, dense = elimination_costs(
        pattern, OF_FACTORS, lambda _pattern, _order, counts: predict(counts)
    )
    return FactorGraphInspection(
        num_variables=len(variables),
        num_factors=len(factors),
        manifolds=dict(Counter(variable.manifold for variable in variables.values())),
        kinds=dict(Counter(type(factor).__name__ for factor in factors)),
        num_columns=columns,
        num_free_variables=len(pattern.sizes),
        num_edges=pattern.num_edges,
        largest_clique=max(sum(is_free[key] for key in factor.keys) for factor in factors),
        nnz=nnz,
        nnz_free=nnz,
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
    return lambda counts: factor_step_terms(rates, work, counts, num_threads)
