"""Report of `bundle align`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from bundle.base.words import number, plural
from bundle.georeference.alignment_result import Alignment, ImageError, metres
from bundle.model.problem import Problem
from bundle.reports.sections import Report, Section, Table
from bundle.reports.terminal.control_points import control_points, plain_metres, suspicions
from bundle.reports.terminal.inputs import about_problem, problem_facts, written

__all__ = ["alignment"]

MOST_IMAGES = 10
"""Number of listed positions, those with the largest errors first."""


def alignment(
    path: str, problem: Problem, aligned: Alignment, output: dict[str, str], lost: Sequence[str]
) -> Report:
    """Return the report on an alignment: the place of the model and the errors.

    Args:
        path: path of the input.
        problem: problem before the alignment.
        aligned: result of the alignment.
        output: path and format of the output.
        lost: data that the output's format cannot store.
    """
    rows = [
        *problem_facts(path, aligned.problem),
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
    rows.append(written(output))
    suspects = suspicions(aligned.control_points)
    notes = (*aligned.notes, *lost)
    return Report(
        command="align",
        input=about_problem(path, problem),
        sections=[
            Section(facts=rows),
            *control_points(aligned.control_points),
            *_images("GPS", aligned.positions, aligned.rms("gps"), "m"),
            *_images("image", aligned.shared_images, aligned.rms("shared_images"), "units"),
            *([Section(notes=suspects, is_warning=True)] if suspects else []),
            *([Section(notes=notes)] if notes else []),
        ],
        data={"georeference": aligned.asdict(), "output": output},
    )


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
