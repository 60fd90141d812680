"""Errors of a model at surveyed check points.

The model is aligned to the control points, and its cameras triangulate all targets. Errors of check
points are those of the model. Without check points, each control point is left out in turn.
Residuals of points that determine the alignment are too small; they are used only if there are too
few points to leave one out. A georeferenced model may stay where it is: then all points count but
the control points of its own georeference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.display import Display, Displayed
from bundle.base.paths import is_path
from bundle.base.records import dataclass
from bundle.base.words import noun, number, plural
from bundle.errors import InputError
from bundle.georeference.alignment import FEWEST, align
from bundle.georeference.alignment_result import Alignment, ControlPointError
from bundle.georeference.control_point import GroundControlPoint
from bundle.georeference.gcp_list import given_control_points
from bundle.georeference.local_frame import LocalFrame
from bundle.georeference.similarity import Similarity
from bundle.georeference.survey import Frame
from bundle.georeference.target_priors import TargetPriors
from bundle.interface.finding import Finding
from bundle.interface.option_fields import choice
from bundle.interface.tabular import Tabular
from bundle.io.georeference_file import georeference_of
from bundle.io.pose_files import first_line
from bundle.model.pose_table import ErrorStatistics, PoseTable
from bundle.model.problem import Problem

KINDS = {
    "check": "check points, which had no influence on the place of A",
    "left_out": "control points, each left out in turn",
    "fitted": "control points that determine the alignment, so that errors are too small",
}
BEGINNINGS = ("EPSG:", "WGS84", "+proj", "+PROJ", "LOCAL", "<?xml")

Array = NDArray[np.float64]


def check_points_of(
    given: Any, format: str | None, model: Problem | PoseTable
) -> tuple[GroundControlPoint, ...] | None:
    """Return check points from paths or from control points; None for other references."""
    if isinstance(given, Sequence) and not isinstance(given, str) and len(given):
        if not all(isinstance(one, GroundControlPoint) for one in given):
            return None
    elif not is_path(given):
        return None
    elif format != "gcp":
        path = Path(given)
        is_tables = not path.exists() and "," in path.name
        is_list = path.is_file() and first_line(path)[1].startswith(BEGINNINGS)
        if format is not None or not (is_tables or is_list):
            return None
    if not isinstance(model, Problem):
        raise InputError("a: expected a model to compare with check points, found poses")
    return given_control_points(given, model)[0]


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
    def of(
        cls,
        problem: Problem,
        points: tuple[GroundControlPoint, ...],
        given: Any = None,
        alignment: str = "similarity",
    ) -> CheckPointEvaluation:
        """Align a model to control points, and return its errors.

        A georeferenced model, whose path is ``given``, stays where it is with ``alignment`` "none",
        and if the points cannot align it.

        Raises:
            InputError: the points do not determine position, scale and attitude of the model.
        """
        place = _georeference_to_keep(given, points, alignment)
        aligned = align(problem, gcps=points) if place is None else _placed(problem, points, place)
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


def _georeference_to_keep(
    given: Any, points: tuple[GroundControlPoint, ...], alignment: str
) -> dict[str, Any] | None:
    is_kept = choice("align", alignment, ("similarity", "none")) == "none"
    controls = sum(one.role == "control" for one in points)
    if not is_kept and controls >= FEWEST:
        return None
    path = Path(given) if is_path(given) else None
    place = georeference_of(path, is_folder=path.is_dir()) if path else None
    if place is None and (is_kept or not controls):
        raise InputError(
            "a: expected a model with georeference.json, as align and refine write it, for "
            f"{'align=none' if is_kept else 'check points only'}, found no such file"
        )
    return place


def _placed(
    problem: Problem, points: tuple[GroundControlPoint, ...], place: Mapping[str, Any]
) -> Alignment:
    """Return the errors of a model in the frame of its georeference.json."""
    origin = LocalFrame(**place["origin"]) if place.get("origin") else None
    if origin is None and any(one.reference_system for one in points):
        raise InputError("b: expected check points in the Cartesian frame of A (LOCAL)")
    frame = Frame(points, None, origin)
    fitted = {one["name"] for one in place.get("gcps", ()) if one["role"] == "control"}
    placed = tuple(
        replace(
            one,
            position=tuple(at.tolist()),
            reference_system=None,
            role="control" if one.name in fitted else "check",
        )
        for one, at in zip(points, frame.control_points, strict=True)
    )
    errors = TargetPriors(placed, (), (), False).point_errors(problem)
    lost = [f"{one.name} is not used: {one.reason}." for one in errors if one.reason]
    if len(lost) == len(errors):
        raise InputError(f"b: expected check points in 2 images of A, found 0 ({lost[0]})")
    same, notes = Similarity(1.0, np.eye(3), np.zeros(3)), (*frame.notes, *lost)
    return Alignment(problem, same, frame.reference_system, origin, errors, (), (), notes)
