"""Georeference of a refined model: content of georeference.json, residuals to measurements."""

from __future__ import annotations

from typing import Any

import numpy as np

from bundle.base.display import Display, Displayed
from bundle.base.records import dataclass
from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.georeference.alignment_result import (
    ControlPointError,
    ImageError,
    metres,
    point_errors,
    root_mean_square,
    suspicions,
)
from bundle.georeference.local_frame import LocalFrame, frame_sentences
from bundle.georeference.measurements import MeasurementErrors, Solved
from bundle.georeference.point_check import OffsetCheck
from bundle.georeference.similarity import Similarity

SAME_BASELINE = 1e-3  # relative change of a rig's baseline below which no note is given
LARGE = 3.0  # length of a residual in sigmas that 3 % of good positions exceed
MOST_IMAGES = 5  # number of listed images with large residuals
NOUNS = {"gps": "position", "control": "control point", "check": "check point"}


@dataclass(frozen=True, eq=False, repr=False)
class Georeference(MeasurementErrors, Displayed):
    """Georeference of a refined model, and the residuals of its positions.

    Attributes:
        reference_system: reference system of the given coordinates; None if Cartesian.
        origin: origin of the frame east, north, up [m] of the refined model; None for Cartesian
            control points.
        similarity: similarity from the input to this frame, before the solve refined it.
        images: every image of the model, if positions of images were given.
        notes: sentences on ignored or inexact data.
        control_points: every control and check point.
        offset: offset of the positions from the control points, estimated or tested; None: nothing
            determines it.
    """

    reference_system: str | None
    origin: LocalFrame | None
    similarity: Similarity
    images: tuple[ImageError, ...]
    notes: tuple[str, ...]
    control_points: tuple[ControlPointError, ...] = ()
    offset: OffsetCheck | None = None

    is_place = True

    @property
    def rms(self) -> tuple[float, float, float]:
        """Root mean square of the residuals in use, east, north, up [m].

        They belong to the control points; without control points, to the used positions of images.
        """
        return self.rms_of("control" if self.control_points else "gps")

    def rms_of(self, kind: str) -> tuple[float, float, float]:
        """Return the root mean square of residuals east, north, up [m]; nan without residuals.

        Args:
            kind: "control", "check" or "gps".
        """
        if kind == "gps":
            return root_mean_square(image.residual for image in self.images if image.used)
        return root_mean_square(p.residual for p in self.control_points if p.role == kind)

    @property
    def suspect_points(self) -> tuple[str, ...]:
        """Names of control and check points that probably have a gross error."""
        return tuple(point.name for point in self.control_points if point.suspect)

    @property
    def suspects(self) -> tuple[ImageError, ...]:
        """Images whose residual exceeds three sigmas, the largest first."""
        large = [image for image in self.images if image.used and image.sigmas > LARGE]
        return tuple(sorted(large, key=lambda image: -image.sigmas))

    @property
    def entries(self) -> dict[str, Any]:
        """Entries of the JSON report."""
        return {"georeference": self.asdict()}

    @property
    def sentences(self) -> list[str]:
        """Errors of positions, control points and check points, and an estimated offset."""
        said = []
        for kind, noun in NOUNS.items():
            rms = self.rms_of(kind)
            if not np.isnan(rms[0]):
                said.append(f"{noun}s {' / '.join(map(_plain, rms))}")
        errors = [f"RMS east / north / up [m]: {'; '.join(said)}."] if said else []
        return [*errors, *self._offset_sentences(), *frame_sentences(self.asdict())]

    def _offset_sentences(self) -> list[str]:
        """Return the estimated offset of the positions in a sentence; findings report others."""
        offset = self.offset
        if offset is None or not offset.is_estimated:
            return []
        _, focal, sigma = offset.focal_lengths
        said = f"{offset.sentence}, estimated."
        if not offset.is_significant:
            return [f"{said} It is not significant (p = {offset.p:.2g}): leave out --gps-offset."]
        if not sigma > 0:
            return [said]
        return [
            f"{said} Only relief separates it from the focal length, {focal:.1f} +- {sigma:.2g} "
            "px: add oblique images or calibrate the focal length."
        ]

    @property
    def warnings(self) -> list[str]:
        """Positions and control points that are probably wrong, then notes."""
        suspects, offset = self.suspects, self.offset
        said = []
        if suspects and (offset is None or offset.is_estimated or not offset.is_significant):
            worst = max(suspects, key=lambda image: image.sigmas)
            said.append(
                f"{plural(len(suspects), 'position')} off by over 3 sigmas, {shown(worst.name)} by "
                f"{worst.sigmas:.1f}."
            )
        return [*said, *suspicions(self.control_points), *self.notes]

    @property
    def displays(self) -> tuple[Display, ...]:
        """Place of the model, its errors, and the images with large errors."""
        rows = []
        if self.images:
            used = sum(image.used for image in self.images)
            rows.append(("positions", f"{used} of {plural(len(self.images), 'image')} used"))
        points = self.control_points
        if points:
            controls = sum(point.role == "control" for point in points)
            checks = plural(sum(point.role == "check" for point in points), "check point")
            rows.append(("control points", f"{controls} of {len(points)} used, {checks}"))
        read = self.reference_system
        frame = f"metres east, north, up; read in {shown(read)}" if read else "metres, as given"
        rows.append(("coordinates", frame))
        if (at := self.origin) is not None:
            place = f"latitude {at.latitude:.8f}, longitude {at.longitude:.8f}"
            rows.append(("origin", f"{place}, height {at.height:.3f} m"))
        rows.append(("scale", f"{number(self.similarity.scale)} m per length unit of the input"))
        for kind, title in (("control", "rms control"), ("check", "rms check"), ("gps", "rms")):
            east, north, up = self.rms_of(kind)
            if not np.isnan(east):
                rows.append((title, f"{east:.4f} m east, {north:.4f} m north, {_plain(up)} m up"))
        cells = tuple(
            (shown(image.name), *map(metres, image.residual), f"{image.sigmas:.1f}")
            for image in self.suspects
        )
        head = ("position off by over 3 sigmas", "east [m]", "north [m]", "up [m]", "sigmas")
        suspects = Display(title="Positions", head=head, rows=cells, most=MOST_IMAGES)
        return (
            Display(title="Place", facts=tuple(rows)),
            *([suspects] if cells else []),
            *point_errors(points, adjusted=True),
        )

    def asdict(self) -> dict[str, Any]:
        """Return the content of ``georeference.json``.

        ``similarity`` maps a point x of the input to scale * rotation @ x + translation, metres
        east, north, up of ``origin``. ``pipeline`` is PROJ's operation from longitude, latitude and
        height on WGS84 to these metres.
        """
        return {
            "reference_system": self.reference_system,
            "origin": self.origin.asdict() if self.origin else None,
            "pipeline": self.origin.pipeline if self.origin else None,
            "similarity": self.similarity.asdict(),
            "gps": [
                {
                    "image": image.name,
                    "residual_enu": list(image.residual),
                    "sigmas": image.sigmas,
                    "used": image.used,
                }
                for image in self.images
            ],
            "gcps": [point.asdict() for point in self.control_points],
            "rms_enu": list(self.rms),
            "rms_enu_check": list(self.rms_of("check")),
            **({} if self.offset is None else {"offset": self.offset.asdict()}),
            "notes": list(self.notes),
        }

    def _display(self) -> Display:
        used = sum(image.used for image in self.images)
        rms = ", ".join(f"{value:.4f}" for value in self.rms)
        facts = []
        if self.origin is not None:
            facts.append(("origin", origin_text(self.origin)))
        if self.images:
            facts.append(("positions", f"of {used} of {plural(len(self.images), 'image')}"))
        if self.control_points:
            controls = sum(point.role == "control" for point in self.control_points)
            facts.append(("control points", f"{controls} of {len(self.control_points)}"))
            facts.append(("suspects", ", ".join(self.suspect_points) or "none"))
        if self.offset is not None and (self.offset.is_significant or self.offset.is_estimated):
            facts.append(("offset", self.offset.sentence))
        facts += [("rms", f"{rms} m east, north, up"), *(("note", note) for note in self.notes)]
        rows = tuple(
            (image.name, *map(metres, image.residual), f"{image.sigmas:.1f}")
            for image in self.suspects[:5]
        )
        head = ("above 3 sigmas", "east [m]", "north", "up", "sigmas")
        return Display(
            title="Georeference", facts=tuple(facts), head=head if rows else (), rows=rows
        )


def _plain(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.4f}"


def origin_text(origin: LocalFrame) -> str:
    """Return latitude, longitude and height in the format of reports."""
    return f"{origin.latitude:.7f}, {origin.longitude:.7f}, {origin.height:.3f} m"


def rig_notes(result: Solved) -> tuple[str, ...]:
    """Return a sentence about baselines of rigs that positions scale; empty without such rigs."""
    problem, moved = result.problem, result.similarity
    lengths = np.linalg.norm(problem.sensor_from_rig[:, 4:], axis=1)
    if moved is None or not lengths.any() or abs(moved.scale - 1) < SAME_BASELINE:
        return ()
    longest = int(np.argmax(lengths))
    return (
        f"Positions scale the rigs by {moved.scale:.6g}: camera "
        f"{problem.sensor_camera_ids[longest]} of rig {problem.sensor_rig_ids[longest]} is "
        f"{lengths[longest]:.4g} m from the reference sensor, {lengths[longest] / moved.scale:.4g} "
        "in the input. A baseline calibrated in metres should stay: check it and the positions.",
    )
