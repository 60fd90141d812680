"""Measured positions and control points in the report of `bundle refine`."""

from __future__ import annotations

import numpy as np

from bundle.base.words import number, plural
from bundle.errors import shown
from bundle.georeference.alignment_result import metres
from bundle.georeference.georeferenced import Georeference
from bundle.reports.sections import Section, Table
from bundle.reports.terminal.control_points import control_points, suspicions

MOST_IMAGES = 5
"""Number of listed images with large residuals."""


def place_sentences(georeference: Georeference) -> list[str]:
    """Return the errors of positions, control points and check points, one sentence for all."""
    said = []
    for kind, noun in (("gps", "position"), ("control", "control point"), ("check", "check point")):
        rms = georeference.rms_of(kind)
        if not np.isnan(rms[0]):
            said.append(f"{noun}s {' / '.join(map(_plain, rms))}")
    sentences = [f"RMS east / north / up [m]: {'; '.join(said)}."] if said else []
    return [*sentences, *_offset(georeference)]


def _offset(georeference: Georeference) -> list[str]:
    """Return the estimated offset of the positions in a sentence; a finding names others."""
    offset = georeference.offset
    if offset is None or not offset.is_estimated:
        return []
    _, focal, sigma = offset.focal_lengths
    said = f"{offset.sentence}, estimated."
    if not offset.is_significant:
        return [f"{said} It is not significant (p = {offset.p:.2g}): leave out --gps-offset."]
    if not sigma > 0:
        return [said]
    return [
        f"{said} Only relief separates it from the focal length, {focal:.1f} +- {sigma:.2g} px: "
        "add oblique images or calibrate the focal length."
    ]


def place_warnings(georeference: Georeference) -> list[str]:
    """Return the positions and control points that are probably wrong, then notes."""
    suspects, offset = georeference.suspects, georeference.offset
    said = []
    if suspects and (offset is None or offset.is_estimated or not offset.is_significant):
        worst = max(suspects, key=lambda image: image.sigmas)
        said.append(
            f"{plural(len(suspects), 'position')} off by over 3 sigmas, {shown(worst.name)} by "
            f"{worst.sigmas:.1f}."
        )
    return [*said, *suspicions(georeference.control_points), *georeference.notes]


def gps_report(georeference: Georeference) -> list[Section]:
    """Return the place of the model, its errors, and the images with large errors."""
    rows = []
    if georeference.images:
        used = sum(image.used for image in georeference.images)
        rows.append(("positions", f"{used} of {plural(len(georeference.images), 'image')} used"))
    points = georeference.control_points
    if points:
        controls = sum(point.role == "control" for point in points)
        checks = sum(point.role == "check" for point in points)
        rows.append(
            ("control points", f"{controls} of {len(points)} used, {plural(checks, 'check point')}")
        )
    read = georeference.reference_system
    frame = f"metres east, north, up; read in {shown(read)}" if read else "metres, as given"
    rows.append(("coordinates", frame))
    origin = georeference.origin
    if origin is not None:
        rows.append(
            (
                "origin",
                f"latitude {origin.latitude:.8f}, longitude {origin.longitude:.8f}, "
                f"height {origin.height:.3f} m",
            )
        )
    rows.append(
        ("scale", f"{number(georeference.similarity.scale)} m per length unit of the input")
    )
    for kind, title in (("control", "rms control"), ("check", "rms check"), ("gps", "rms")):
        east, north, up = georeference.rms_of(kind)
        if not np.isnan(east):
            rows.append((title, f"{east:.4f} m east, {north:.4f} m north, {_plain(up)} m up"))
    sections = [Section(facts=rows)]
    suspects = georeference.suspects
    if suspects:
        cells = [
            (shown(image.name), *map(metres, image.residual), f"{image.sigmas:.1f}")
            for image in suspects
        ]
        head = ("position off by over 3 sigmas", "east [m]", "north [m]", "up [m]", "sigmas")
        table = Table.of(head, cells, most=MOST_IMAGES, others=_others)
        sections.append(Section(tables=[table]))
    sections += control_points(points, adjusted=True)
    return sections


def _others(count: int) -> str:
    return f"{plural(count, 'other image')} as well; --json FILE lists all"


def _plain(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.4f}"
