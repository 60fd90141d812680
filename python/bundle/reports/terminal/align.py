"""Report of `bundle align`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from bundle.base.words import number, plural
from bundle.georeference.alignment_result import (
    Alignment,
    ImageError,
    metres,
    plain_metres,
    point_errors,
    suspicions,
)
from bundle.model.problem import Problem
from bundle.reports.sections import Report, Section, Table, displayed
from bundle.reports.terminal.inputs import about_input, input_facts, written

MOST_IMAGES = 10
"""Number of listed positions, those with the largest errors first."""


def alignment(
    path: str, problem: Problem, aligned: Alignment, output: dict[str, str], lost: Sequence[str]
) -> Report:
    """Return the report on an alignment of a problem: the place of the model and the errors."""
    rows = [
        *input_facts(path, aligned.problem),
        ("scale", f"{number(aligned.similarity.scale)} per length unit of the input"),
    ]
    if aligned.reference_system:
        rows.append(("coordinates", aligned.reference_system))
    if aligned.origin:
        origin = aligned.origin
        rows.append(
            (
                "east, north, up",
                f"about {origin.latitude:.7f}, {origin.longitude:.7f} degrees, "
                f"{origin.height:.3f} m",
            )
        )
    if not np.isnan(aligned.sigma0):
        rows.append(("residuals", f"{number(aligned.sigma0)} sigmas"))
    details = [
        Section(facts=rows),
        *displayed(point_errors(aligned.control_points)),
        *_images("GPS", aligned.positions, aligned.rms("gps"), "m"),
        *_images("image", aligned.shared_images, aligned.rms("shared_images"), "units"),
    ]
    return Report(
        command="align",
        input=about_input(path, problem),
        headline=_headline(aligned),
        warnings=[*suspicions(aligned.control_points), *aligned.notes, *lost],
        sections=[
            Section(facts=[written(output)]),
            *(dataclasses.replace(section, is_detail=True) for section in details),
        ],
        data={"georeference": aligned.asdict(), "output": output},
    )


def _headline(aligned: Alignment) -> list[str]:
    """Return the errors of what determined the alignment, then those of check points."""
    said = []
    controls = [point for point in aligned.control_points if point.role == "control"]
    checks = [point for point in aligned.control_points if point.role == "check"]
    for kind, things, noun in (
        ("control", controls, "control point"),
        ("gps", [image for image in aligned.positions if image.used], "position"),
        ("shared_images", [image for image in aligned.shared_images if image.used], "shared image"),
        ("check", checks, "check point"),
    ):
        rms = aligned.rms(kind)
        if things and not np.isnan(rms[0]):
            axes = "x / y / z" if kind == "shared_images" else "east / north / up"
            unit = "units" if kind == "shared_images" else "m"
            errors = " / ".join(map(plain_metres, rms))
            said.append(f"{plural(len(things), noun)}: rms {errors} {unit} {axes}.")
    scale = f"Aligned, scale {number(aligned.similarity.scale)}."
    return [f"{scale} {said[0]}" if said else scale, *said[1:]]


def _images(
    title: str, images: Iterable[ImageError], rms: Iterable[float], unit: str
) -> list[Section]:
    """Return the images with the largest errors, and the root mean square of all errors."""
    found = list(images)
    if not found:
        return []
    order = sorted(found, key=lambda image: -float(np.nansum(np.square(image.residual))))
    cells = [
        (image.name, "used" if image.used else "not used", *map(metres, image.residual))
        for image in order[:MOST_IMAGES]
    ]
    cells.append(("total rms", plural(len(found), "image"), *map(plain_metres, rms)))
    head = (f"worst {title}", "role", f"east [{unit}]", "north", "up")
    if unit != "m":
        head = (f"worst {title}", "role", f"x [{unit}]", "y", "z")
    return [Section(tables=[Table.of(head, cells, left=2)])]
