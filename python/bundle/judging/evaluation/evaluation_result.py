"""Result of a comparison of poses with a reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number
from bundle.georeference.similarity import Similarity
from bundle.interface.finding import Finding
from bundle.interface.judging_options import AUC_DEFINITIONS
from bundle.interface.tabular import Tabular, columns_of
from bundle.judging.evaluation.association import Association
from bundle.judging.evaluation.lens_difference import LensDifference
from bundle.judging.evaluation.movement_in_sigmas import SigmaMovement
from bundle.judging.evaluation.pair_errors import PairErrors, PointDifference
from bundle.model.pose_table import ErrorStatistics

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RelativeErrors:
    """Relative pose errors (RPE) over ``delta`` poses."""

    delta: int  # number of poses
    position: ErrorStatistics  # statistics of translations in length units of B
    rotation: ErrorStatistics  # statistics of rotations in degrees


@dataclass(frozen=True)
class SharedImage:
    """Errors of one shared image or time."""

    name: str  # name of the image, time in seconds, or number of the pose
    position: float  # distance of the centres after the alignment in length units of B
    rotation: float  # angle between the rotations in degrees
    sigmas: float | None = None  # movement in sigmas of A's covariance; None if it was not computed


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Evaluation(Displayed, Tabular):
    """Comparison of an estimate A with a reference B, in B's frame and length unit.

    Attributes:
        verdict: "identical", "agrees", "close", "differs" or "contradicts"; see docs/evaluate.md.
        headline: verdict in sentences.
        findings: facts to act on.
        association: pairs of poses, and poses without a partner.
        inputs: format and counts of A and of B.
        unit: length unit of B: "m" for trajectories, otherwise "units".
        alignment: "similarity", "rigid", "yaw" or "none".
        similarity: map from the frame of A to that of B.
        size: root mean square distance of B's shared centres from their mean.
        position: statistics of the position errors (APE) in length units of B.
        rotation: statistics of the rotation errors in degrees.
        position_errors: (n,) position errors of the pairs.
        rotation_errors: (n,) rotation errors of the pairs in degrees.
        relative: errors of the motion between consecutive poses (RPE).
        pairs: accuracy of relative poses over all pairs.
        auc_definition: definition of ``auc``, a key of ``pairs.auc``.
        lenses: difference of each pair of cameras of shared images; () unless both are models.
        points: distances of points with common tracks; None unless both are models.
        movement: movement in sigmas of A's covariance; None if it was not computed.
        notes: remarks, one sentence each.
        estimate: (n, 3) aligned centres of A.
        reference: (n, 3) centres of B.
    """

    verdict: str
    headline: tuple[str, ...]
    findings: tuple[Finding, ...]
    association: Association
    inputs: tuple[dict[str, Any], dict[str, Any]]
    unit: str
    alignment: str
    similarity: Similarity
    size: float
    position: ErrorStatistics
    rotation: ErrorStatistics
    position_errors: Array
    rotation_errors: Array
    relative: RelativeErrors
    pairs: PairErrors
    auc_definition: str
    lenses: tuple[LensDifference, ...]
    points: PointDifference | None
    movement: SigmaMovement | None
    notes: tuple[str, ...]
    estimate: Array
    reference: Array

    @property
    def num_shared(self) -> int:
        """Number of shared images or times."""
        return len(self.association)

    @property
    def auc(self) -> dict[str, float]:
        """AUC by threshold in degrees, such as "5", by ``auc_definition``."""
        return self.pairs.auc[self.auc_definition]

    @property
    def images(self) -> tuple[SharedImage, ...]:
        """Errors of each shared image, in the order of names or times."""
        sigmas = [None] * self.num_shared if self.movement is None else self.movement.sigmas
        return tuple(
            SharedImage(name, float(p), float(r), None if s is None else float(s))
            for name, p, r, s in zip(
                self.association.names,
                self.position_errors,
                self.rotation_errors,
                sigmas,
                strict=True,
            )
        )

    def _tables(self) -> dict[str, Mapping[str, Any]]:
        return {"images": columns_of(self.images), **super()._tables()}

    @property
    def lens_difference(self) -> dict[str, Any] | None:
        """Lens differences of all pairs of cameras, with their statistics; None without pairs."""
        if not self.lenses:
            return None
        fields = np.concatenate([lens.field.reshape(-1, 2) for lens in self.lenses])
        lengths = np.linalg.norm(fields, axis=1)
        cameras = [
            {
                "camera_a": lens.camera_a,
                "camera_b": lens.camera_b,
                "num_images": lens.num_images,
                "rotation_degrees": lens.angle,
                **asdict(lens.pixels),
            }
            for lens in self.lenses
        ]
        return {
            **asdict(ErrorStatistics.of(lengths[np.isfinite(lengths)])),
            "unit": "pixels",
            "cameras": cameras,
        }

    def asdict(self) -> dict[str, Any]:
        """Return everything that the JSON of ``bundle evaluate`` has, without the headline."""
        found = self.association
        moved = self.movement
        return {
            "verdict": self.verdict,
            "num_shared": self.num_shared,
            "association": {"by": found.by, "sentence": found.sentence},
            "missing": {"only_in_a": list(found.only_a), "only_in_b": list(found.only_b)},
            "unit": self.unit,
            "alignment": self.alignment,
            "similarity": self.similarity.asdict(),
            "size": self.size,
            "position": asdict(self.position),
            "rotation": asdict(self.rotation),
            "rpe": asdict(self.relative),
            "auc": self.auc,
            "auc_definition": self.auc_definition,
            "auc_description": AUC_DEFINITIONS[self.auc_definition],
            "auc_by_definition": self.pairs.auc,
            "rra": self.pairs.rotation_accuracy,
            "rta": self.pairs.translation_accuracy,
            "num_pairs": self.pairs.num_pairs,
            "num_pairs_at_one_place": self.pairs.num_pairs_at_one_place,
            "images": [asdict(image) for image in self.images],
            "lens_difference": self.lens_difference,
            "points": None if self.points is None else asdict(self.points),
            "movement": None
            if moved is None
            else {
                "median_sigmas": moved.median,
                "max_sigmas": moved.largest,
                "sigma0": moved.sigma0,
                "is_minimum": moved.is_minimum,
            },
            "notes": list(self.notes),
        }

    def _display(self) -> Display:
        auc = ", ".join(f"{limit} deg {value:.4f}" for limit, value in self.auc.items())
        return Display(
            title=" ".join(self.headline),
            facts=(
                ("position", f"{number(self.position.rmse)} rms, max {number(self.position.max)}"),
                ("rotation", f"{number(self.rotation.rmse)} degrees rms"),
                (f"AUC ({self.auc_definition})", auc),
            ),
        )
