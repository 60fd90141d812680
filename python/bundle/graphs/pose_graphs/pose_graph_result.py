"""Result of the solve of a pose graph, with its certificate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import change, number, plural, seconds
from bundle.interface.pose_graph_options import PoseGraphOptions
from bundle.interface.solve_record import SolveRecord
from bundle.interface.summary import Summary
from bundle.model.pose_graph_arrays import PoseGraph


@dataclass(frozen=True, kw_only=True)
class LeftOutEdge:
    """Closure outside the largest consistent set."""

    edge: int  # index of the edge in the graph
    # largest chi2 of a pair with a closure of the set; 3 or 6 degrees of freedom if both closures
    # are correct
    chi2: float
    num_contradicted: int  # number of closures in the set that are inconsistent with this edge


@dataclass(frozen=True, kw_only=True, repr=False, init=False, eq=False)
class PoseGraphSummary(Summary):
    """Summary (:class:`bundle.Summary`) with chi2; costs are 1/2 sum rho(||r||^2) over the edges.

    Attributes:
        chi2_initial: sum r^T Omega r at the given poses, without 1/2, loss and left-out edges; for
            a graph without poses, at the start of the solve.
        chi2_start: the same sum at the start, to which ``init`` may have moved the poses.
        chi2_final: the same sum at the end.
        init: start of the solve: "file", "odometry", "spanning_tree", "chordal",
            "staircase" or "chordal_minimum" (a second solve, with ``certify``).
        init_choice: reason for that start; "" if it was requested.
        loss: loss of the final solve; the chosen loss for "auto".
        loss_choice: reason for that loss; "" if it was requested.
        num_components: connected components of the graph.
        num_gauge_freedoms: gauge degrees of freedom that the solve removes by holding poses
            constant: 3 or 6 per component without a FIX.
        held_pose_ids: ids of these constant poses.
        num_rejected_edges: edges that the loss has rejected.
        num_left_out_edges: closures that ``consistency`` has left out of the solve.
    """

    chi2_initial: float
    chi2_start: float
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
    """Poses at the end of a solve, with its summary.

    Attributes:
        problem: graph with the final poses.
        initial_problem: the given graph.
        options: all options as used.
        summary: the solver's summary.
        iterations: one array per field of Ceres' IterationSummary, one entry per iteration.
        chi2_before: (m,) r^T Omega r of each edge at the given poses, without loss; for a graph
            without poses, at the start of the solve.
        chi2_after: (m,) r^T Omega r of each edge at the end, without loss.
        weights: (m,) final factor rho' of the loss on the information of each edge; 0 or 1 for
            gnc_tls; 0 for edges left out.
        rejected: indices of edges that the loss has rejected, worst first. Their weight is below
            1/2 and their chi2 is exceeded by one correct edge in a million (gnc_tls: weight 0).
        left_out: closures that ``consistency`` has left out, by descending chi2 of a pair.
        certificate: certificate of the first minimum that the solve found, with ``certify``;
            otherwise None. The poses are those of ``certificate.staircase``, refined, if these are
            lower (``summary.init`` is "staircase"), or those of ``certificate.problem``
            ("chordal_minimum").
        build_time_in_seconds: time outside the solver.
        solve_time_in_seconds: time inside the solver.
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
    certificate: Certificate | None = None

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


CERTIFIED, NOT_CERTIFIED, NOT_A_MINIMUM = "certified", "not-certified", "not-a-minimum"

STAIRCASE, CHORDAL_MINIMUM = ESCAPES = ("staircase", "chordal_minimum")
"""Names of the starts of second solves."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Certificate(Displayed):
    """Result of :func:`bundle.certify`.

    The certificate is about the chordal cost F of the edges (``docs/certificates.md``), without a
    factor 1/2, at the critical point to which Newton's method moves the given poses.

    Attributes:
        verdict: "certified": no poses have an F below ``cost - gap``. "not-certified": the test
            fails; a lower minimum may exist. "not-a-minimum": no minimum of F is near the given
            poses, so a certificate does not apply to them.
        is_settled: True if the given poses are near a minimum of F or of chi2. False: refine first.
        cost: F at the critical point.
        initial_cost: F at the given poses.
        lower_bound: F of any poses is at least this number, by the dual problem. It may be negative
            if the test fails.
        gap: ``cost`` minus the lower bound, or minus 0 if the bound is negative.
        min_eigenvalue: smallest eigenvalue of the certificate matrix, with the translations
            eliminated; 0 up to rounding if certified.
        eigenvalues: smallest eigenvalues outside of the null space of a critical point, ascending.
        num_steps: steps of Newton's method from the given poses.
        weights: weights of the edges, "mean" or "se-sync".
        error: error of the edges to which the weights and ``chi2`` refer.
        is_isotropic: True if these weights represent the information of every edge exactly.
        chi2: sum of r^T Omega r at the given poses, with the information of the graph.
        chi2_lower_bound: chi2 of any poses is at least this number; nan without a bound.
        problem: graph at the critical point.
        staircase: poses with a lower F or a better bound, if the test failed; otherwise None.
    """

    verdict: str
    is_settled: bool
    cost: float
    initial_cost: float
    lower_bound: float
    min_eigenvalue: float
    eigenvalues: NDArray[np.float64]
    num_steps: int
    weights: str
    error: str
    is_isotropic: bool
    chi2: float
    chi2_lower_bound: float
    problem: PoseGraph
    staircase: Staircase | None = None

    @property
    def is_certified(self) -> bool:
        """True if the verdict is "certified"."""
        return self.verdict == CERTIFIED

    @property
    def gap(self) -> float:
        """``cost`` minus the lower bound, which is 0 or above; never negative."""
        return max(self.cost - max(self.lower_bound, 0.0), 0.0)

    @property
    def chi2_gap(self) -> float:
        """Largest amount by which chi2 of the given poses may exceed the smallest chi2."""
        return max(self.chi2 - self.chi2_lower_bound, 0.0)

    def _display(self) -> Display:
        facts = [
            ("cost", number(self.cost)),
            ("gap", number(self.gap)),
            ("eigenvalue", f"{self.min_eigenvalue:.6g}"),
            ("graph", plural(self.problem.num_poses, "pose")),
        ]
        if self.staircase is not None:
            facts.append(("staircase", f"rank {self.staircase.rank}, {self.staircase.verdict}"))
        return Display(title=f"Certificate: {self.verdict}", facts=tuple(facts))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Staircase(Displayed):
    """Poses that the Riemannian staircase found from poses without a certificate.

    Attributes:
        verdict: "certified" or "not-certified".
        rank: last rank of the relaxation.
        relaxed_cost: F of the relaxation at this rank.
        cost: F of the poses, after rounding and refinement.
        lower_bound: largest lower bound of F that was found.
        gap: ``cost`` minus the lower bound, or minus 0 if the bound is negative.
        min_eigenvalue: smallest eigenvalue of the certificate matrix at these poses.
        eigenvalues: smallest eigenvalues outside of the null space.
        problem: graph at these poses.
    """

    verdict: str
    rank: int
    relaxed_cost: float
    cost: float
    lower_bound: float
    min_eigenvalue: float
    eigenvalues: NDArray[np.float64]
    problem: PoseGraph

    @property
    def gap(self) -> float:
        """``cost`` minus the lower bound, which is 0 or above; never negative."""
        return max(self.cost - max(self.lower_bound, 0.0), 0.0)

    def _display(self) -> Display:
        facts = [("rank", str(self.rank)), ("cost", number(self.cost)), ("gap", number(self.gap))]
        return Display(title=f"Staircase: {self.verdict}", facts=tuple(facts))
