"""What `bundle align` says."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from rich.console import RenderableType

from bundle.base.tables import columns, facts, format_name, notes, plural
from bundle.base.words import contents, number
from bundle.errors import shown
from bundle.georeference.alignment_result import Alignment, ImageError, metres
from bundle.model.problem import Problem
from bundle.reports.terminal import json
from bundle.reports.terminal.control_points import control_point_table, plain_metres, suspicions

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
    suspects = suspicions(aligned.control_points)
    return [
        facts(rows),
        *control_point_table(aligned.control_points),
        *_images("GPS", "used", aligned.positions, aligned.rms("gps"), "m"),
        *_images("image", "used", aligned.shared_images, aligned.rms("shared_images"), "units"),
        *([""] if suspects else []),
        *notes(suspects, style="yellow"),
        *([""] if aligned.notes or lost else []),
        *notes((*aligned.notes, *lost)),
    ]


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
    cells.append(("total rms", plural(len(found), "image"), *map(plain_metres, rms)))
    head = (f"worst {title}", "role", f"east [{unit}]", "north", "up")
    if unit != "m":
        head = (f"worst {title}", "role", f"x [{unit}]", "y", "z")
    return ["", columns(head, cells, left=2)]


def as_json(
    path: str, problem: Problem, aligned: Alignment, output: dict[str, str]
) -> dict[str, Any]:
    """Return the report of `bundle align`."""
    return {
        **json.heading("align", path, problem),
        "georeference": json.plain(aligned.asdict()),
        "output": output,
    }
