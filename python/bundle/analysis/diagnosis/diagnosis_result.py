"""Results of the diagnosis of a problem, of a pose graph and of a factor graph."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.arrays import FrozenArrays, no_rows
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number, plural
from bundle.errors import InputError, brief
from bundle.interface.finding import Finding
from bundle.interface.tabular import Tabular

if TYPE_CHECKING:
    from bundle.analysis.uncertainty.reliability_result import Reliability

DIGITS = 16  # decimal digits of a double, rounded up as in the table of condition numbers


@dataclass(frozen=True, kw_only=True)
class WeakMode:
    """Direction that the observations, edges or factors determine weakly or not at all.

    Attributes:
        kind: stable name for programs, such as "flat_scene". For graphs, "component": no edge joins
            a component with the largest one; "open_joint": the edges between a group of poses and
            the others leave directions free; "weak_joint": they determine directions weakly;
            "open_together": further free directions, in which several groups move together. For
            factor graphs, "open_direction": no factor determines it; "weak_direction": the factors
            determine it weakly.
        sentence: moving parameters, cause, and remedy.
        image_ids: images that move.
        camera_ids: cameras whose parameters move.
        eigenvalue: eigenvalue of the scaled reduced camera system; 0.0 for an undetermined
            direction. For a graph, an eigenvalue of the information of its edges, in units of
            typical sigmas; about 1 for a typical edge.
        dimension: number of such directions in the reduced system; 0 if only points move.
        pose_ids: poses of a graph that move, or keys of a factor graph.
        edges: pairs of pose ids: the edges that connect these poses with the others.
    """

    kind: str
    sentence: str
    image_ids: tuple[int, ...] = ()
    camera_ids: tuple[int, ...] = ()
    eigenvalue: float = 0.0
    dimension: int = 1
    pose_ids: tuple[Any, ...] = ()
    edges: tuple[tuple[Any, ...], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Component:
    """Images that points connect, or poses that edges connect, and nothing connects with others.

    Attributes:
        image_ids: ids of the images, ascending.
        num_points: number of points that they observe.
        pose_ids: ids of the poses of a graph, ascending; for a factor graph, the keys of free
            variables.
        num_edges: number of edges between the poses.
        num_fixed: number of fixed poses; without one the component is free to move.
    """

    image_ids: tuple[int, ...] = ()
    num_points: int = 0
    pose_ids: tuple[Any, ...] = ()
    num_edges: int = 0
    num_fixed: int = 0

    @property
    def size(self) -> int:
        """Number of images, poses or variables."""
        return len(self.image_ids) + len(self.pose_ids)


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
class Diagnosis(FrozenArrays, Displayed, Tabular):
    """Determined and undetermined parameters of a problem or a graph at its values.

    Eigenvalues of a problem are those of the reduced camera system S (points eliminated), with rows
    and columns scaled to a unit diagonal; ids are those of the source. Eigenvalues of a graph are
    those of the normal equations of a solve, without fixed and held poses, scaled likewise. They
    depend on which pose is held constant, unlike covariances of relative poses. For a
    :class:`bundle.FactorGraph`, keys take the place of ids, variables that of poses, and factors
    that of edges. Attributes that an input does not have are empty.

    Attributes:
        nullity: number of null directions; for a problem, those of S, without points that lack
            parallax and other undetermined points.
        expected_nullity: number of null directions due to the gauge: 7 for images alone, 6 if a
            rig determines the scale, 0 if priors or fixed images determine the frame; for a graph,
            3 in 2D and 6 in 3D for each component without a fixed pose.
        nullity_is_exact: False if there are more null directions than were searched, or more loose
            clusters of poses than can be analysed together.
        components: components that nothing connects, the largest first.
        weak_modes: components of a graph first, then null directions beyond the gauge, then weak
            ones.
        points_without_parallax: ids of points with two or more observations that do not determine
            the depth.
        collapsed: clusters of points that lie on cameras, the largest first.
        condition_number: condition number of the scaled matrix without its null space; NaN if
            nothing is determined.
        condition_number_unscaled: the same without scaling.
        eigenvalues: smallest nonzero eigenvalues, ascending.
        max_null_eigenvalue: largest eigenvalue that counts as zero; NaN for a graph.
        unobserved_points: ids of points without observations.
        points_seen_once: ids of points with one observation.
        points_seen_twice: ids of points with two observations.
        points_at_cameras: ids of points at the centre of a camera that observes them.
        points_at_infinity: ids of points that are so far away that their rays are nearly parallel.
        images_with_few_observations: ids of images with fewer than 10.
        images_with_few_shared_points: ids of images that share fewer than 5 points with others.
        findings: all findings in sentences, problems first.
        held_pose_ids: poses of a graph that a solve holds constant, besides the fixed ones: the
            first one of each component without a fixed pose.
        suspicious_edges: edges that others contradict, the worst first.
        edge_redundancy: (m,) number of the d errors of an edge that the other edges check: 0 for
            an edge in no loop. NaN for edges of weight 0, for edges of undetermined poses, and if
            rounding errors hide the number.
        edge_test: (m,) test of :class:`SuspiciousEdge`; NaN likewise, and away from a minimum.
        noise_scale: factor between actual and expected chi2 of correct edges, from the median over
            the edges, at least 1; tests are compared with chi2 times this factor.
        reliability: redundancy of the measurements, if it was requested.
    """

    nullity: int
    expected_nullity: int
    nullity_is_exact: bool = True
    components: tuple[Component, ...]
    weak_modes: tuple[WeakMode, ...]
    points_without_parallax: NDArray[np.int64] = no_rows(np.int64)
    collapsed: tuple[CollapsedCluster, ...] = ()
    condition_number: float
    condition_number_unscaled: float
    eigenvalues: NDArray[np.float64]
    max_null_eigenvalue: float = math.nan
    unobserved_points: NDArray[np.int64] = no_rows(np.int64)
    points_seen_once: NDArray[np.int64] = no_rows(np.int64)
    points_seen_twice: NDArray[np.int64] = no_rows(np.int64)
    points_at_cameras: NDArray[np.int64] = no_rows(np.int64)
    points_at_infinity: NDArray[np.int64] = no_rows(np.int64)
    images_with_few_observations: NDArray[np.int64] = no_rows(np.int64)
    images_with_few_shared_points: NDArray[np.int64] = no_rows(np.int64)
    findings: tuple[Finding, ...]
    held_pose_ids: tuple[Any, ...] = ()
    suspicious_edges: tuple[SuspiciousEdge, ...] = ()
    edge_redundancy: NDArray[np.float64] = no_rows(float)
    edge_test: NDArray[np.float64] = no_rows(float)
    noise_scale: float = 1.0
    reliability: Reliability | None = None

    @property
    def noun(self) -> str:
        """Noun of the members of components: "pose" for a graph, otherwise "image"."""
        return "pose" if any(part.pose_ids for part in self.components) else "image"

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

    @property
    def rank_gap(self) -> float:
        """Ratio of the smallest nonzero eigenvalue to the largest eigenvalue that counts as zero.

        Thousands or more if the rank is clear; infinite if no eigenvalue counts as zero; NaN if all
        do, and for a graph.
        """
        highest = self.max_null_eigenvalue
        if len(self.eigenvalues) == 0 or math.isnan(highest):
            return math.nan
        return float(self.eigenvalues[0]) / highest if highest > 0 else math.inf

    @property
    def held_words(self) -> str:
        """Held poses in words, such as ", 0 held"; "" if there are none."""
        if not self.held_pose_ids:
            return ""
        one = len(self.held_pose_ids) == 1
        what = brief(self.held_pose_ids[0]) if one else f"{len(self.held_pose_ids):,}"
        return f", {what} held"

    def save(self, path: str) -> None:
        """Write the arrays of the reliability to an .npz file.

        Raises:
            InputError: the reliability was not requested.
            OSError: the file cannot be written.
        """
        if self.reliability is None:
            raise InputError("output: expected together with reliability, whose arrays it has")
        self.reliability.save(path)

    def _display(self) -> Display:
        lowest = f"{self.eigenvalues[0]:.3g}" if len(self.eigenvalues) else "-"
        condition = f"{number(self.condition_number)}{self.held_words} (lowest eigenvalue {lowest})"
        facts = [("condition", condition), ("components", str(len(self.components)))]
        for name, wanted in (("problem", True), ("note", False)):
            said = [entry.sentence for entry in self.findings if entry.is_problem is wanted]
            facts += [(name if k == 0 else "", words) for k, words in enumerate(said)]
        return Display(title=f"Diagnosis: {self.verdict}", facts=tuple(facts))


GraphDiagnosis, GraphComponent, GraphWeakMode = Diagnosis, Component, WeakMode
"""Former names of the diagnosis of a graph and its parts, which pickles have."""
