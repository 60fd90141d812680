"""Result of the diagnosis of a pose graph."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.conditioning import Conditioned
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number
from bundle.errors import brief
from bundle.interface.finding import Finding
from bundle.interface.tabular import Tabular


@dataclass(frozen=True, kw_only=True)
class GraphComponent:
    """Poses that are connected by edges, and not connected with other poses.

    Attributes:
        pose_ids: ids of the poses, ascending; of a factor graph the keys of free variables.
        num_edges: number of edges between them.
        num_fixed: number of fixed poses; without one the component is free to move.
    """

    pose_ids: tuple[Any, ...]
    num_edges: int
    num_fixed: int


@dataclass(frozen=True, kw_only=True)
class GraphWeakMode:
    """Direction that the edges determine weakly or not at all.

    Attributes:
        kind: "component": no edge joins a component with the largest one; "open_joint": the edges
            between a group of poses and the others leave directions free; "weak_joint": they
            determine directions weakly; "open_together": further free directions, in which several
            groups move together. Of a factor graph "open_direction": no factor determines it;
            "weak_direction": the factors determine it weakly.
        sentence: moving poses, their motion, the responsible edges, and the remedy.
        pose_ids: poses that move.
        edges: pairs of pose ids: the edges that connect them with the others.
        eigenvalue: eigenvalue of the information of these edges, in units of typical sigmas; about
            1 for a typical edge.
        dimension: number of such directions.
    """

    kind: str
    sentence: str
    pose_ids: tuple[Any, ...]
    edges: tuple[tuple[Any, ...], ...]
    eigenvalue: float
    dimension: int


@dataclass(frozen=True, kw_only=True)
class SuspiciousEdge:
    """Edge that the other edges contradict.

    Attributes:
        edge: ids of its poses.
        line: line in the file; None for a graph from memory.
        chi2: r^T Omega r.
        test: r^T K^+ r with K the covariance of the edge's error in the fit; chi2 distributed.
        degrees: degrees of freedom of the test: directions of the edge that other edges check.
    """

    edge: tuple[Any, ...]
    line: int | None
    chi2: float
    test: float
    degrees: int


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class GraphDiagnosis(Conditioned, Displayed, Tabular):
    """Determined and undetermined directions of a graph at its poses, or at its variables' values.

    For a :class:`bundle.FactorGraph`, keys take the place of ids, variables that of poses, and
    factors that of edges.

    Attributes:
        nullity: number of directions of the poses that change no error.
        expected_nullity: number of directions due to the gauge: 3 in the plane and 6 in space for
            each component without a fixed pose.
        nullity_is_exact: False if more clusters of poses are loose than can be analysed together.
        components: connected components, the largest first.
        weak_modes: components first, then undetermined directions, then weak ones.
        held_pose_ids: poses that a solve holds constant, besides the fixed ones: the first one of
            each component without a fixed pose.
        condition_number: condition number of the determined part of the normal equations of a
            solve, without fixed and held poses, scaled to a unit diagonal. With another held pose,
            such as one in the middle of a chain, it is another number; covariances of relative
            poses are the same.
        condition_number_unscaled: the same without scaling.
        eigenvalues: smallest eigenvalues of the scaled normal equations, ascending.
        suspicious_edges: edges that others contradict, the worst first.
        edge_redundancy: (m,) number of the d errors of an edge that the other edges check: 0 for
            an edge in no loop. NaN for edges of weight 0, for edges of undetermined poses, and if
            rounding errors hide the number.
        edge_test: (m,) test of :class:`SuspiciousEdge`; NaN likewise, and away from a minimum.
        noise_scale: factor between actual and expected chi2 of correct edges, from the median over
            the edges, at least 1; tests are compared with chi2 times this factor.
        findings: all findings in sentences, problems first.
    """

    nullity: int
    expected_nullity: int
    nullity_is_exact: bool
    components: tuple[GraphComponent, ...]
    weak_modes: tuple[GraphWeakMode, ...]
    held_pose_ids: tuple[Any, ...]
    condition_number: float
    condition_number_unscaled: float
    eigenvalues: NDArray[np.float64]
    suspicious_edges: tuple[SuspiciousEdge, ...]
    edge_redundancy: NDArray[np.float64]
    edge_test: NDArray[np.float64]
    noise_scale: float
    findings: tuple[Finding, ...]

    @property
    def held_words(self) -> str:
        """Held poses in words, such as ", 0 held"; "" if there are none."""
        if not self.held_pose_ids:
            return ""
        one = len(self.held_pose_ids) == 1
        what = brief(self.held_pose_ids[0]) if one else f"{len(self.held_pose_ids):,}"
        return f", {what} held"

    def _display(self) -> Display:
        facts = [
            ("condition", f"{number(self.condition_number)}{self.held_words}"),
            ("components", str(len(self.components))),
        ]
        for name, wanted in (("problem", True), ("note", False)):
            said = [entry.sentence for entry in self.findings if entry.is_problem is wanted]
            facts += [(name if k == 0 else "", words) for k, words in enumerate(said)]
        return Display(title=f"GraphDiagnosis: {self.verdict}", facts=tuple(facts))
