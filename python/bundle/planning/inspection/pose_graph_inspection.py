"""What a step of the solve of a pose graph costs in each order of elimination."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bundle import _core
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
"""Those that a solve can be asked for."""

BYTES = 8


@dataclass(frozen=True, kw_only=True)
class EliminationCost:
    """What the Cholesky factor L costs in one order of the poses, counted exactly.

    Attributes:
        ordering: "natural" (by position), "amd" or "metis".
        nnz_factor: nonzeros of the lower triangle of L with its diagonal, without zeros that
            supernodes add.
        fill: pairs of poses that meet in L and not in the matrix.
        flops: sum of c^2 + 3 c over the columns of L, c their entries below the diagonal.
        tree_height: poses on the longest path of the elimination tree.
        memory_in_bytes: of the numbers of L.
    """

    ordering: str
    nnz_factor: int
    fill: int
    flops: int
    tree_height: int
    memory_in_bytes: int


@dataclass(frozen=True, kw_only=True, repr=False)
class PoseGraphInspection(Displayed):
    """The normal equations of a pose graph and what factorising them costs.

    Attributes:
        num_poses: of the graph.
        num_edges: pairs of poses that edges join, each once.
        block_size: 3 in the plane, 6 in space.
        nnz: nonzeros of the information matrix over all poses, both triangles and the diagonal.
        density: share of its cells that are not zero.
        num_free_poses: that a solve does not hold; the costs are of these.
        nnz_free: nonzeros of the information matrix over these.
        costs: one an ordering.
        auto_ordering: the one that a solve takes; "" where nothing is free.
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
        """Return which order to take, and why, in a sentence."""
        if not self.auto_ordering:
            return "Nothing to factorise: every pose is held."
        flops = {cost.ordering: cost.flops for cost in self.costs}
        chosen, worst = flops[self.auto_ordering], max(flops.values())
        least = min(flops, key=lambda name: flops[name])
        words = f"Leave --pose-ordering at auto: it takes {self.auto_ordering}, "
        if worst > chosen:
            words += f"{number(worst / max(chosen, 1))} times fewer flops than the worst"
        else:
            words += "and all orders cost the same"
        if flops[least] < chosen:
            words += f" ({least} would save {100 - round(100 * flops[least] / chosen)} % of them, "
            words += "and take longer to find than that saves)"
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
    """Count what a step of the solve of a pose graph costs; see :func:`bundle.inspect`.

    Raises:
        InputError: the source is no pose graph.
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
