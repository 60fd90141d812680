"""Cost of factorising the normal equations of a pose graph, by elimination order."""

from __future__ import annotations

from typing import Any

import numpy as np

import bundle._core as _core
from bundle.base.arrays import check_type
from bundle.base.display import Display, Displayed
from bundle.base.paths import as_path, is_path
from bundle.base.records import dataclass
from bundle.base.words import plural
from bundle.graphs.pose_graphs.edge_weights import check_free_pose
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.interface.tabular import Tabular
from bundle.io.g2o_files import load_g2o
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.planning.inspection.elimination_costs import (
    EliminationCost,
    advise,
    display_of,
    elimination_costs,
)
from bundle.planning.inspection.graph_rates import free_pairs, panel_work, step_terms
from bundle.planning.inspection.machine_rates import graph_rates

ORDERINGS = ("natural", "amd", "metis")
"""Orders that a solve offers."""


@dataclass(frozen=True, kw_only=True, repr=False)
class PoseGraphInspection(Displayed, Tabular):
    """Normal equations of a pose graph and the cost of factorising them.

    Attributes:
        num_poses: number of poses.
        num_edges: distinct pairs of poses with an edge.
        block_size: 3 in the plane (SE(2)), 6 in space (SE(3)).
        nnz: nonzeros of the information matrix over all poses, both triangles and the diagonal.
        density: share of nonzeros in that matrix.
        num_free_poses: poses that a solve does not hold constant; the costs are for these.
        nnz_free: nonzeros of the information matrix over the free poses.
        costs: one per order, then the dense matrix.
        auto_ordering: order that ``auto`` selects.
        num_threads: threads of the predicted times.
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
    num_threads: int

    @property
    def recommendation(self) -> str:
        """Recommended order and the reason, in one sentence."""
        return advise(self.costs, self.auto_ordering, "--pose-ordering at auto")

    def _display(self) -> Display:
        poses = f"{plural(self.num_poses, 'pose')}, {plural(self.num_edges, 'edge')}"
        return display_of(self, "matrix", poses)


def inspect_pose_graph(
    source: Any, num_threads: int = 0, *, recalibrate: bool = False
) -> PoseGraphInspection:
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
    pairs = np.unique(np.sort(graph.edges, axis=1), axis=0)
    kept, num_free = free_pairs(graph)
    threads = min(num_threads or _core.hardware_threads(), _core.hardware_threads())
    rates = graph_rates(threads, recalibrate=recalibrate)
    costs = elimination_costs(
        np.full(num_free, d, np.int32),
        kept,
        ORDERINGS,
        lambda pattern, order, _: step_terms(rates, graph, panel_work(pattern, order, threads)),
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
        costs=costs,
        auto_ordering=_core.auto_ordering(graph, held),
        num_threads=threads,
    )
