"""Cost of factorising the normal equations of a pose graph, by elimination order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import bundle._core as _core
from bundle.base.arguments import check_type
from bundle.base.display import Display, Displayed
from bundle.base.paths import as_path, is_path
from bundle.base.words import number, plural
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.inspection.graph_inspection import pattern_of_edges

__all__ = ["EliminationCost", "PoseGraphInspection", "inspect_pose_graph"]

ORDERINGS = ("natural", "amd", "metis")
"""Orders that a solve offers."""

BYTES = 8


@dataclass(frozen=True, kw_only=True)
class EliminationCost:
    """Exact cost of the Cholesky factor L in one order of the poses.

    Attributes:
        ordering: "natural" (by position), "amd" or "metis".
        nnz_factor: nnz(L): lower triangle with its diagonal, without the zeros that supernodes
            store.
        fill: fill-in: pairs of poses that are nonzero in L and zero in the matrix.
        flops: sum of c^2 + 3 c over the columns of L with c entries below the diagonal.
        tree_height: poses on the longest path of the elimination tree.
        memory_in_bytes: memory of the values of L.
    """

    ordering: str
    nnz_factor: int
    fill: int
    flops: int
    tree_height: int
    memory_in_bytes: int


@dataclass(frozen=True, kw_only=True, repr=False)
class PoseGraphInspection(Displayed):
    """Normal equations of a pose graph and the cost of factorising them.

    Attributes:
        num_poses: number of poses.
        num_edges: distinct pairs of poses with an edge.
        block_size: 3 in the plane (SE(2)), 6 in space (SE(3)).
        nnz: nonzeros of the information matrix over all poses, both triangles and the diagonal.
        density: share of nonzeros in that matrix.
        num_free_poses: poses that a solve does not hold constant; the costs are for these.
        nnz_free: nonzeros of the information matrix over the free poses.
        costs: one per order.
        auto_ordering: order that ``auto`` selects; "" without free poses.
    """

    num_poses: int
    num_edges: int
    block_size: int
    nnz: int
    density: float
    num_free_poses: int
    nnz_free: int
    costs: tuple[EliminationCost, ...]
    auto_ordering: str

    @property
    def recommendation(self) -> str:
        """Recommended order and the reason, in one sentence."""
        if not self.auto_ordering:
            return "Nothing to factorise: every pose is constant."
        flops = {cost.ordering: cost.flops for cost in self.costs}
        chosen, worst = flops[self.auto_ordering], max(flops.values())
        least = min(flops, key=lambda name: flops[name])
        words = f"Leave --pose-ordering at auto: it selects {self.auto_ordering}, "
        if worst > chosen:
            words += f"{number(worst / max(chosen, 1))} times fewer flops than the worst order"
        else:
            words += "and all orders cost the same"
        if flops[least] < chosen:
            words += f" ({least} needs {100 - round(100 * flops[least] / chosen)} % fewer, "
            words += "but computing it takes longer than it saves)"
        return words + "."

    def _display(self) -> Display:
        facts = [
            ("matrix", f"{self.nnz} nonzeros, {100 * self.density:.4g} %"),
            *(
                (cost.ordering, f"{cost.nnz_factor} nonzeros of L, {number(cost.flops)} flops")
                for cost in self.costs
            ),
            ("advice", self.recommendation),
        ]
        poses = f"{plural(self.num_poses, 'pose')}, {plural(self.num_edges, 'edge')}"
        return Display(title=f"PoseGraphInspection: {poses}", facts=tuple(facts))


def inspect_pose_graph(source: Any) -> PoseGraphInspection:
    """Count the cost of a step of a pose graph's solve; see :func:`bundle.inspect`.

    Raises:
        InputError: the source is not a pose graph.
        OSError: the path cannot be read.
    """
    if isinstance(source, PoseGraphResult):
        source = source.problem
    elif is_path(source):
        source = load_g2o(as_path(source))
    check_type("graph", source, PoseGraph)
    graph: PoseGraph = source
    d = graph.tangent_size
    held, _, _ = _core.hold_poses(graph)
    pairs = np.unique(np.sort(graph.edges.astype(np.int64), axis=1), axis=0).reshape(-1, 2)
    free = np.cumsum(~held) - 1
    kept = free[pairs[~held[pairs].any(axis=1)]]
    num_free = int((~held).sum())
    costs = []
    if num_free:
        pattern = pattern_of_edges(np.full(num_free, d, np.int32), kept)
        for name in ORDERINGS:
            counts = _core.count_factor(*pattern, _core.order_blocks(*pattern, name))
            costs.append(
                EliminationCost(
                    ordering=name,
                    nnz_factor=int(counts["entries"]),
                    fill=int(counts["fill_edges"]),
                    flops=int(counts["flops"]),
                    tree_height=int(counts["tree_height"]),
                    memory_in_bytes=BYTES * int(counts["entries"]),
                )
            )
    nnz = d * d * (graph.num_poses + 2 * len(pairs))
    return PoseGraphInspection(
        num_poses=graph.num_poses,
        num_edges=len(pairs),
        block_size=d,
        nnz=nnz,
        density=nnz / (d * graph.num_poses) ** 2,
        num_free_poses=num_free,
        nnz_free=d * d * (num_free + 2 * len(kept)),
        costs=tuple(costs),
        auto_ordering=_core.auto_ordering(graph, held),
    )
