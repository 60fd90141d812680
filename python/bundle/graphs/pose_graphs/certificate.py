"""Certificate of a pose graph: verdict, bounds, and the better poses of a staircase."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number, plural
from bundle.model.pose_graph_arrays import PoseGraph

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
            fails; a lower minimum may exist. "not-a-minimum": the given poses are near no
            minimum of F, so that a certificate says nothing about them.
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
