"""Result of a diagnosis."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.conditioning import Conditioned
from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number
from bundle.interface.finding import Finding
from bundle.interface.tabular import Tabular


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
    image_ids: tuple[int, ...]
    camera_ids: tuple[int, ...]
    eigenvalue: float
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
