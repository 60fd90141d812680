"""Result of a diagnosis."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bundle.analysis.diagnosis.conditioning import Conditioned, Finding
from bundle.base.display import Display, Displayed
from bundle.base.words import number

__all__ = ["CollapsedCluster", "Component", "Diagnosis", "Finding", "WeakMode"]


@dataclass(frozen=True, kw_only=True)
class WeakMode:
    """A direction in which the observations determine little or nothing.

    Attributes:
        kind: a stable name for programs, such as "flat_scene".
        sentence: what moves against what, why, and what to do.
        image_ids: images that move.
        camera_ids: cameras whose parameters move.
        eigenvalue: of the scaled reduced camera system; 0.0 where nothing is determined.
        dimension: how many such directions the reduced system has; 0 where points alone move.
    """

    kind: str
    sentence: str
    image_ids: tuple[int, ...]
    camera_ids: tuple[int, ...]
    eigenvalue: float
    dimension: int = 1


@dataclass(frozen=True, kw_only=True)
class Component:
    """Images that points connect, and that nothing connects with others.

    Attributes:
        image_ids: ascending.
        num_points: points that they see.
    """

    image_ids: tuple[int, ...]
    num_points: int


@dataclass(frozen=True, kw_only=True)
class CollapsedCluster:
    """Points that sit on the cameras that see them.

    Attributes:
        point_ids: ascending.
        image_ids: those that see them so, ascending.
        num_observations: with a depth below 1e-4 of the median.
    """

    point_ids: tuple[int, ...]
    image_ids: tuple[int, ...]
    num_observations: int


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Diagnosis(Conditioned, Displayed):
    """Determined and undetermined parameters of a problem at its values.

    Eigenvalues are those of the reduced camera system S (points eliminated), with each row and
    column scaled so that its diagonal is one. Ids are those of the source.

    Attributes:
        nullity: null directions of S, points without parallax and undetermined points left out.
        expected_nullity: what the gauge explains: 7 for images alone, 6 where a rig gives the
            scale, 0 where priors or fixed images say where the world is.
        nullity_is_exact: False where there are more null directions than were looked for.
        components: pieces of the world without common points, the largest first.
        weak_modes: null directions beyond the gauge first, then weak ones.
        points_without_parallax: ids of points with two observations or more whose depth no
            observation sees.
        collapsed: clusters of points that sit on cameras, the largest first.
        condition_number: of the scaled S on what it determines; NaN where that is nothing.
        condition_number_unscaled: of S as it is.
        eigenvalues: the lowest that are not zero, ascending.
        max_null_eigenvalue: of those that count as zero.
        unobserved_points: ids of points without observations.
        points_seen_once: ids.
        points_seen_twice: ids.
        points_at_cameras: ids of points at the centre of a camera that sees them.
        points_at_infinity: ids of points so far away that their rays are parallel, almost.
        images_with_few_observations: ids of images with fewer than 10.
        images_with_few_shared_points: ids of images with fewer than 5 points that others see.
        findings: all of that in sentences, problems first.
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
        """The lowest eigenvalue that is not zero by the largest that counts as zero.

        Thousands and more where the rank is sharp; infinite where nothing counts as zero, NaN where
        nothing else is left.
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
