"""Result of the diagnosis of a pose graph."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.conditioning import Conditioned, Finding
from bundle.base.display import Display, Displayed
from bundle.base.words import number

__all__ = ["GraphComponent", "GraphDiagnosis", "GraphWeakMode", "SuspiciousEdge"]


@dataclass(frozen=True, kw_only=True)
class GraphComponent:
    """Poses that edges join, and that no edge joins with others.

    Attributes:
        pose_ids: ascending.
        num_edges: between them.
        num_fixed: of the poses; with none the component floats.
    """

    pose_ids: tuple[int, ...]
    num_edges: int
    num_fixed: int


@dataclass(frozen=True, kw_only=True)
class GraphWeakMode:
    """A direction that edges leave open or hold weakly.

    Attributes:
        kind: "component", "open_joint", "weak_joint" or "open_together".
        sentence: which poses move how, which edges are to blame, what to do.
        pose_ids: poses that move.
        edges: pairs of pose ids: the edges that join them with the others.
        eigenvalue: of what these edges say, in units of typical sigmas; a typical edge has about 1.
        dimension: how many such directions there are.
    """

    kind: str
    sentence: str
    pose_ids: tuple[int, ...]
    edges: tuple[tuple[int, int], ...]
    eigenvalue: float
    dimension: int


@dataclass(frozen=True, kw_only=True)
class SuspiciousEdge:
    """An edge that the others contradict.

    Attributes:
        edge: ids of its poses.
        line: of the file; None from memory.
        chi2: r^T Omega r.
        test: r^T K^+ r with K the covariance of the edge's error in the fit: distributed as chi2.
        degrees: of freedom of the test: directions of the edge that others check.
    """

    edge: tuple[int, int]
    line: int | None
    chi2: float
    test: float
    degrees: int


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GraphDiagnosis(Conditioned, Displayed):
    """Directions that the edges of a pose graph determine at its poses, and those that they do not.

    Attributes:
        nullity: directions of the poses that change no error.
        expected_nullity: what the gauge explains: 3 in the plane and 6 in space for each component
            without a fixed pose.
        nullity_is_exact: False where more clusters of poses are loose than are looked at together.
        components: the largest first.
        weak_modes: components first, then what is open, then what is weak.
        condition_number: of the normal equations as a solve takes them (fixed poses and the first
            of each other component left out), scaled to a diagonal of ones, on what is determined.
        condition_number_unscaled: of the same as they are.
        eigenvalues: the lowest of the scaled ones, ascending.
        suspicious_edges: edges that others contradict, the worst first.
        edge_redundancy: (m,) how much of the d errors of an edge the other edges check: 0 for an
            edge in no loop; NaN for edges of weight 0, where something is not determined, and
            where rounding hides it.
        edge_test: (m,) as :class:`SuspiciousEdge` has it; NaN likewise, and away from a minimum.
        noise_scale: factor of chi2 by which right edges scatter more than their information says,
            by the median over the edges, at least 1; tests are compared with chi2 times it.
        findings: all of that in sentences, problems first.
    """

    nullity: int
    expected_nullity: int
    nullity_is_exact: bool
    components: tuple[GraphComponent, ...]
    weak_modes: tuple[GraphWeakMode, ...]
    condition_number: float
    condition_number_unscaled: float
    eigenvalues: NDArray[np.float64]
    suspicious_edges: tuple[SuspiciousEdge, ...]
    edge_redundancy: NDArray[np.float64]
    edge_test: NDArray[np.float64]
    noise_scale: float
    findings: tuple[Finding, ...]

    def _display(self) -> Display:
        facts = [
            ("condition", number(self.condition_number)),
            ("components", str(len(self.components))),
        ]
        for name, wanted in (("problem", True), ("note", False)):
            said = [entry.sentence for entry in self.findings if entry.is_problem is wanted]
            facts += [(name if k == 0 else "", words) for k, words in enumerate(said)]
        return Display(title=f"GraphDiagnosis: {self.verdict}", facts=tuple(facts))
