"""What `bundle refine` says of measured positions."""

from __future__ import annotations

from rich.console import RenderableType

from bundle.errors import shown
from bundle.georeference import Georeference
from bundle.georeference.alignment_result import metres
from bundle.tables import columns, facts, notes, number, plural

__all__ = ["gps_report"]

MOST_IMAGES = 5
"""Images of large residuals that are listed."""


def gps_report(georeference: Georeference) -> list[RenderableType]:
    """Return where the model is, how well the positions fit, and which images they do not fit."""
    origin = georeference.origin
    used = sum(image.used for image in georeference.images)
    east, north, up = (f"{value:.4f}" for value in georeference.rms)
    rows = [
        ("positions", f"of {used} of {plural(len(georeference.images), 'image')}"),
        ("coordinates", f"metres east, north, up; read in {shown(georeference.reference_system)}"),
        (
            "origin",
            f"latitude {origin.latitude:.8f}, longitude {origin.longitude:.8f}, "
            f"height {origin.height:.3f} m",
        ),
        ("scale", f"{number(georeference.similarity.scale)} m per length unit of the input"),
        ("rms", f"{east} m east, {north} m north, {up} m up"),
    ]
    report: list[RenderableType] = [facts(rows), *notes(georeference.notes)]
    suspects = georeference.suspects
    if suspects:
        cells = [
            (shown(image.name), *map(metres, image.residual), f"{image.sigmas:.1f}")
            for image in suspects[:MOST_IMAGES]
        ]
        head = ("position off by over 3 sigmas", "east [m]", "north [m]", "up [m]", "sigmas")
        report += ["", columns(head, cells)]
        if len(suspects) > MOST_IMAGES:
            others = plural(len(suspects) - MOST_IMAGES, "other image")
            report += notes([f"{others} as well; --json FILE lists all"])
    return [*report, ""]
