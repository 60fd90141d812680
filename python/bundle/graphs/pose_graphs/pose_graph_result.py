"""What the solve of a pose graph gives back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display
from bundle.base.words import change, plural, seconds
from bundle.graphs.pose_graphs.consistency import LeftOutEdge
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.solve_record import SolveRecord
from bundle.interface.summary import Summary
from bundle.model.pose_graph_arrays import PoseGraph

__all__ = ["PoseGraphResult", "PoseGraphSummary"]


@dataclass(frozen=True, kw_only=True, repr=False)
class PoseGraphSummary(Summary):
    """A :class:`bundle.Summary`, its costs 1/2 sum rho(||r||^2) over the edges, and chi2.

    Attributes:
        chi2_initial: sum r^T Omega r at the start, no 1/2, no loss, without edges left out.
        chi2_final: likewise at the end.
        init: where the solve started: "file", "odometry", "spanning_tree" or "chordal".
        init_choice: why there; "" where it was asked for.
        loss: that the solve ended with: of loss "auto" the one taken, else the one asked for.
        loss_choice: why that one; "" where it was asked for.
        num_components: connected components of the graph.
        num_gauge_freedoms: degrees of freedom that were taken away, by holding poses that no FIX
            holds: 3 or 6 for each component without one.
        held_pose_ids: those poses.
        num_rejected_edges: edges that the loss has put out of action.
        num_left_out_edges: closures that ``consistency`` has left out of the solve.
    """

    chi2_initial: float
    chi2_final: float
    init: str
    init_choice: str
    loss: str
    loss_choice: str
    num_components: int
    num_gauge_freedoms: int
    held_pose_ids: tuple[int, ...]
    num_rejected_edges: int
    num_left_out_edges: int = 0


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class PoseGraphResult(SolveRecord):
    """The poses that a solve found and how it came about.

    Attributes:
        problem: the graph with the poses found.
        initial_problem: the graph as it was given.
        options: every option as used.
        summary: what the solver says.
        iterations: one array a field of Ceres' IterationSummary, one entry an iteration.
        chi2_before: (m,) r^T Omega r of each edge at the start, no loss.
        chi2_after: likewise at the end.
        weights: (m,) what the loss leaves of the information of each edge at the end: rho', 0 or 1
            for gnc_tls, 0 for edges left out.
        rejected: edges that the loss has put out of action, by position, worst first: with a weight
            below a half and a chi2 that one right edge in a million has (gnc_tls: a weight of 0).
        left_out: closures that ``consistency`` has left out, the largest chi2 of a pair first.
        build_time_in_seconds: outside the solver.
        solve_time_in_seconds: inside the solver.
    """

    problem: PoseGraph
    initial_problem: PoseGraph
    options: PoseGraphOptions  # type: ignore[assignment]
    summary: PoseGraphSummary
    chi2_before: NDArray[np.float64]
    chi2_after: NDArray[np.float64]
    weights: NDArray[np.float64]
    rejected: tuple[int, ...]
    left_out: tuple[LeftOutEdge, ...] = ()

    def _display(self) -> Display:
        summary, graph = self.summary, self.problem
        facts = [
            ("chi2", change(summary.chi2_initial, summary.chi2_final)),
            ("time", f"{seconds(self.build_time_in_seconds + self.solve_time_in_seconds)} s"),
            ("solver", f"{summary.backend_used} {summary.linear_solver_type_used}"),
            ("graph", f"{plural(graph.num_poses, 'pose')}, {plural(graph.num_edges, 'edge')}"),
            *(("warning", warning) for warning in summary.warnings),
        ]
        return Display(title=f"PoseGraphResult: {self.outcome}", facts=tuple(facts))
