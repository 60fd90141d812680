"""Results of the diagnosis of a problem, of a pose graph and of a factor graph."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number, plural
from bundle.errors import brief
from bundle.interface.finding import Finding
from bundle.interface.tabular import Tabular

DIGITS = 16
"""Decimal digits of a double, rounded up as in the table of condition numbers."""


class Conditioned:
    """Conclusions from rank, condition number and findings of a diagnosis."""

    nullity: int
    expected_nullity: int
    nullity_is_exact: bool
    condition_number: float
    findings: tuple[Finding, ...]

    @property
    def ok(self) -> bool:
        """True if the problem is fully determined."""
        return not any(finding.is_problem for finding in self.findings)

    @property
    def digits_normal_equations(self) -> int:
        """Digits of a step from the normal equations: 16 - log10(cond S), at least 0."""
        return self._digits(1.0)

    @property
    def digits_square_root(self) -> int:
        """Digits of a step from a QR factorisation of the Jacobian; cond J = sqrt(cond S)."""
        return self._digits(0.5)

    def _digits(self, power: float) -> int:
        condition = self.condition_number
        if math.isnan(condition):
            return 0
        return max(0, round(DIGITS - power * math.log10(max(condition, 1.0))))

    @property
    def verdict(self) -> str:
        """Verdict on the rank in one sentence."""
        more = self.nullity - self.expected_nullity
        least = "" if self.nullity_is_exact else "at least "
        words = f"{least}{plural(self.nullity, 'null direction')}"
        if more == 0:
            return f"{words}, all of them gauge" if self.nullity else "no null direction"
        if more > 0:
            return f"{words}: {self.expected_nullity} are gauge, {more} are not determined"
        return f"{words}, fewer than the {self.expected_nullity} of the gauge"


@dataclass(frozen=True, kw_only=True)
class WeakMode:
    """Direction that the observations determine weakly or not at all.

    Attributes:
        kind: stable name for programs, such as "flat_scene".
        sentence: moving parameters, cause, and remedy.
        image_ids: images that move.
        camera_ids: cameras whose parameters move.
        eigenvalue: eigenvalue of the scaled reduced camera system; 0.0 for an undetermined
            direction.
        dimension: number of such directions in the reduced system; 0 if only points move.
    """

    kind: str
    sentence: str
    image_ids: tuple[int, ...] = ()
    camera_ids: tuple[int, ...] = ()
    eigenvalue: float = 0.0
    dimension: int = 1


@dataclass(frozen=True, kw_only=True)
class Component:
    """Images that are connected by points, and not connected with other images.

    Attributes:
        image_ids: ids of the images, ascending.
        num_points: number of points that they observe.
    """

    image_ids: tuple[int, ...]
    num_points: int


@dataclass(frozen=True, kw_only=True)
class CollapsedCluster:
    """Points that lie on the cameras that observe them.

    Attributes:
        point_ids: ids of the points, ascending.
        image_ids: ids of these images, ascending.
        num_observations: number of observations with a depth below 1e-4 of the median.
    """

    point_ids: tuple[int, ...]
    image_ids: tuple[int, ...]
    num_observations: int


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Diagnosis(Conditioned, Displayed, Tabular):
    """Determined and undetermined parameters of a problem at its values.

    Eigenvalues are those of the reduced camera system S (points eliminated), with rows and columns
    scaled to a unit diagonal. Ids are those of the source.

    Attributes:
        nullity: number of null directions of S, without points that lack parallax and other
            undetermined points.
        expected_nullity: number of null directions due to the gauge: 7 for images alone, 6 if a
            rig determines the scale, 0 if priors or fixed images determine the frame.
        nullity_is_exact: False if there are more null directions than were searched.
        components: connected components without common points, the largest first.
        weak_modes: null directions beyond the gauge first, then weak ones.
        points_without_parallax: ids of points with two or more observations that do not determine
            the depth.
        collapsed: clusters of points that lie on cameras, the largest first.
        condition_number: condition number of the scaled S without its null space; NaN if nothing
            is determined.
        condition_number_unscaled: condition number of S without scaling.
        eigenvalues: smallest nonzero eigenvalues, ascending.
        max_null_eigenvalue: largest eigenvalue that counts as zero.
        unobserved_points: ids of points without observations.
        points_seen_once: ids of points with one observation.
        points_seen_twice: ids of points with two observations.
        points_at_cameras: ids of points at the centre of a camera that observes them.
        points_at_infinity: ids of points that are so far away that their rays are nearly parallel.
        images_with_few_observations: ids of images with fewer than 10.
        images_with_few_shared_points: ids of images that share fewer than 5 points with others.
        findings: all findings in sentences, problems first.
    """

    nullity: int
    expected_nullity: int
    nullity_is_exact: bool = True
    components: tuple[Component, ...]
    weak_modes: tuple[WeakMode, ...]
    points_without_parallax: NDArray[np.int64]
    collapsed: tuple[CollapsedCluster, ...]
    condition_number: float
    condition_number_unscaled: float
    eigenvalues: NDArray[np.float64]
    max_null_eigenvalue: float
    unobserved_points: NDArray[np.int64]
    points_seen_once: NDArray[np.int64]
    points_seen_twice: NDArray[np.int64]
    points_at_cameras: NDArray[np.int64]
    points_at_infinity: NDArray[np.int64]
    images_with_few_observations: NDArray[np.int64]
    images_with_few_shared_points: NDArray[np.int64]
    findings: tuple[Finding, ...]

    @property
    def rank_gap(self) -> float:
        """Ratio of the smallest nonzero eigenvalue to the largest eigenvalue that counts as zero.

        Thousands or more if the rank is clear; infinite if no eigenvalue counts as zero; NaN if all
        do.
        """
        if len(self.eigenvalues) == 0:
            return math.nan
        lowest, highest = float(self.eigenvalues[0]), self.max_null_eigenvalue
        return lowest / highest if highest > 0 else math.inf

    def _display(self) -> Display:
        problems = [entry.sentence for entry in self.findings if entry.is_problem]
        others = [entry.sentence for entry in self.findings if not entry.is_problem]
        lowest = f"{self.eigenvalues[0]:.3g}" if len(self.eigenvalues) else "-"
        facts = [
            ("condition", f"{number(self.condition_number)} (lowest eigenvalue {lowest})"),
            ("components", str(len(self.components))),
        ]
        facts += [("problem" if k == 0 else "", words) for k, words in enumerate(problems)]
        facts += [("note" if k == 0 else "", words) for k, words in enumerate(others)]
        return Display(title=f"Diagnosis: {self.verdict}", facts=tuple(facts))


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
    edges: tuple[tuple[Any, ...], ...] = ()
    eigenvalue: float = 0.0
    dimension: int = 1


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
