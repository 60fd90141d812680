"""Errors of a model at surveyed check points.

The model is aligned to the control points, and its cameras triangulate all targets
(``georeference.alignment``).
Targets that the file marks as check points had no influence on the alignment, and their errors are
those of the model. Without such targets, each control point is left out in turn, and its error is
the one at the point that was left out. Residuals of points that determine the alignment are smaller
than the errors of the model; they are used only if there are too few points to leave one out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.paths import is_path
from bundle.base.records import dataclass
from bundle.base.words import noun, number, plural
from bundle.georeference.alignment import align
from bundle.georeference.alignment_result import Alignment, ControlPointError
from bundle.georeference.control_point import GroundControlPoint
from bundle.georeference.gcp_list import read_gcp_list
from bundle.interface.finding import Finding
from bundle.interface.tabular import Tabular
from bundle.io.pose_files import first_line
from bundle.model.pose_table import ErrorStatistics
from bundle.model.problem import Problem

KINDS = {
    "check": "check points, which had no influence on the alignment",
    "left_out": "control points, each left out in turn",
    "fitted": "control points that determine the alignment, so that errors are too small",
}
BEGINNINGS = ("EPSG:", "WGS84", "+proj", "+PROJ")

Array = NDArray[np.float64]


def check_points_of(given: Any, format: str | None) -> tuple[GroundControlPoint, ...] | None:
    """Return check points from a path or from control points; None for other references."""
    if isinstance(given, Sequence) and not isinstance(given, str) and len(given):
        points = [one for one in given if isinstance(one, GroundControlPoint)]
        return tuple(points) if len(points) == len(given) else None
    if not is_path(given):
        return None
    if format == "gcp":
        return read_gcp_list(given)
    path = Path(given)
    if format is None and path.is_file() and first_line(path)[1].startswith(BEGINNINGS):
        return read_gcp_list(given)
    return None


@dataclass(frozen=True, eq=False, repr=False)
class CheckPointEvaluation(Displayed, Tabular):
    """Errors of a model at check points, in metres.

    Attributes:
        alignment: alignment of the model to the control points, with every target.
        kind: "check", "left_out" or "fitted": the points that count; see ``KINDS``.
        points: the points that count.
        errors: (n, 3) their errors east, north, up; NaN for an unknown height.
        position: statistics of the lengths of the errors.
    """

    alignment: Alignment
    kind: str
    points: tuple[ControlPointError, ...]
    errors: Array
    position: ErrorStatistics

    @classmethod
    def of(cls, problem: Problem, points: tuple[GroundControlPoint, ...]) -> CheckPointEvaluation:
        """Align a model to control points, and return its errors.

        Raises:
            InputError: the points do not determine position, scale and attitude of the model.
        """
        aligned = align(problem, gcps=points)
        used = [point for point in aligned.control_points if point.role != "unused"]
        check = [point for point in used if point.role == "check"]
        kind, chosen = "check", check
        errors = np.array([point.residual for point in check]).reshape(-1, 3)
        if not check:
            kind, chosen = "left_out", used
            errors = np.array([point.leave_one_out for point in used]).reshape(-1, 3)
            if np.isnan(errors[:, :2]).any():
                kind, errors = "fitted", np.array([point.residual for point in used])
        lengths = np.sqrt(np.nansum(errors**2, axis=1))
        return cls(aligned, kind, tuple(chosen), errors, ErrorStatistics.of(lengths))

    @property
    def headline(self) -> tuple[str, ...]:
        """Verdict in sentences."""
        lengths = np.sqrt(np.nansum(self.errors**2, axis=1))
        worst = self.points[int(np.argmax(lengths))].name
        across = float(np.sqrt(np.nanmean((self.errors[:, :2] ** 2).sum(axis=1))))
        up = self.errors[np.isfinite(self.errors[:, 2]), 2]
        height = f", {number(float(np.sqrt((up**2).mean())))} m in height" if len(up) else ""
        return (
            f"A differs from {plural(len(self.points), 'surveyed point')} by "
            f"{number(self.position.rmse)} m rms: {number(across)} m horizontally{height}; at most "
            f"{number(self.position.max)} m ({worst}).",
            f"These are {KINDS[self.kind]}.",
        )

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Points that probably have a gross error."""
        suspects = self.alignment.suspects
        if not suspects:
            return ()
        return (
            Finding(
                kind="suspect_points",
                sentence=f"{plural(len(suspects), 'point')} probably "
                f"{noun(len(suspects), 'has', 'have')} a gross error: "
                f"{', '.join(suspects[:5])}.",
                evidence={"points": list(suspects)},
            ),
        )

    def asdict(self) -> dict[str, Any]:
        """Return everything that the JSON of ``bundle evaluate`` has, without the headline."""
        return {
            "num_shared": len(self.points),
            "kind": self.kind,
            "similarity": self.alignment.similarity.asdict(),
            "position": asdict(self.position),
            "rotation": None,
            "auc": None,
            "images": [],
            "lens_difference": None,
            "check_points": [
                {"error_enu": error.tolist(), **point.asdict()}
                for point, error in zip(self.points, self.errors, strict=True)
            ],
            "notes": list(self.alignment.notes),
        }

    def _display(self) -> Display:
        return Display(title=" ".join(self.headline))
