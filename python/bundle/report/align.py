"""What `bundle align` says."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from rich.console import RenderableType

from bundle.errors import shown
from bundle.georeference import Alignment, ImageError
from bundle.georeference.alignment_result import metres
from bundle.problem import Problem
from bundle.report import json
from bundle.tables import columns, facts, format_name, notes, pixels, plural
from bundle.words import contents, number

__all__ = ["alignment", "as_json"]

MOST_IMAGES = 10
"""Positions that are listed, the worst first."""


def alignment(
    path: str, aligned: Alignment, output: dict[str, str], lost: tuple[str, ...]
) -> list[RenderableType]:
    """Return the place and the errors of an alignment as tables and sentences."""
    problem = aligned.problem
    rows = [
        ("input", f"{shown(path)} ({format_name(problem.format)})"),
        ("", contents(problem)),
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
    rows.append(("output", f"{shown(output['path'])} ({format_name(output['format'])})"))
    suspects = [
        f"{point.name} is probably wrong: the other points place it "
        f"{', '.join(_offsets(point.leave_one_out))} of its coordinates."
        for point in aligned.control_points
        if point.suspect
    ]
    return [
        facts(rows),
        *_control_points(aligned),
        *_images("GPS", "used", aligned.positions, aligned.rms("gps"), "m"),
        *_images("image", "used", aligned.shared_images, aligned.rms("shared_images"), "units"),
        *([""] if suspects else []),
        *notes(suspects, style="yellow"),
        *([""] if aligned.notes or lost else []),
        *notes((*aligned.notes, *lost)),
    ]


def _control_points(aligned: Alignment) -> list[RenderableType]:
    points = aligned.control_points
    if not points:
        return []
    cells = [
        (
            point.name,
            "suspect" if point.suspect else point.role,
            str(point.num_images),
            *map(metres, point.residual),
            *map(metres, point.leave_one_out),
            pixels(point.pixels),
        )
        for point in points
    ]
    for kind in ("control", "check"):
        chosen = [point for point in points if point.role == kind]
        if chosen:
            px = np.sqrt(np.mean([point.pixels**2 for point in chosen]))
            rms = (_plain(value) for value in aligned.rms(kind))
            label = f"total rms {kind}"
            cells.append((label, plural(len(chosen), "point"), "", *rms, "", "", "", pixels(px)))
    head = ("control point", "role", "images", "east [m]", "north", "up")
    return ["", columns((*head, "without: east", "north", "up", "[px]"), cells, left=2)]


def _images(
    title: str, used: str, images: Iterable[ImageError], rms: Iterable[float], unit: str
) -> list[RenderableType]:
    """Return the worst images and the root mean square of all."""
    found = list(images)
    if not found:
        return []
    order = sorted(found, key=lambda image: -float(np.nansum(np.square(image.residual))))
    cells = [
        (image.name, used if image.used else "not used", *map(metres, image.residual))
        for image in order[:MOST_IMAGES]
    ]
    cells.append(("total rms", plural(len(found), "image"), *map(_plain, rms)))
    head = (f"worst {title}", "role", f"east [{unit}]", "north", "up")
    if unit != "m":
        head = (f"worst {title}", "role", f"x [{unit}]", "y", "z")
    return ["", columns(head, cells, left=2)]


def _plain(value: float) -> str:
    return "-" if np.isnan(value) else f"{value:.3f}"


def _offsets(residual: Iterable[float]) -> list[str]:
    """Return "-4.081 m east" and so on."""
    named = zip(residual, ("east", "north", "up"), strict=True)
    return [f"{metres(value)} m {axis}" for value, axis in named if not np.isnan(value)]


def as_json(
    path: str, problem: Problem, aligned: Alignment, output: dict[str, str]
) -> dict[str, Any]:
    """Return the report of `bundle align`."""
    return {
        **json.heading("align", path, problem),
        "georeference": json.plain(aligned.asdict()),
        "output": output,
    }
