"""Projection uncertainty: heat maps over each camera's image, and curves over the distance."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from bundle.base.words import plural
from bundle.figures.lens_figures import distance_figure, sigma_figure, top_sigma
from bundle.figures.projection_uncertainty import ProjectionUncertainty
from bundle.reports.page.page import tag
from bundle.reports.page.svg import grid
from bundle.reports.page.table import rounded

__all__ = ["projection_data", "projection_section"]

WORDS = (
    "Standard deviation of the pixel of a point that is fixed to the camera, in the worst "
    "direction, from the noise of the measurements (mrcal's projection uncertainty). A small "
    "rotation or shift of the camera that compensates the error is not counted. Errors of the "
    "lens model come on top, and where nothing was observed the model extrapolates."
)


def projection_section(known: Sequence[ProjectionUncertainty], num_cameras: int) -> str:
    """Return the figures of each camera.

    Args:
        known: computed uncertainties, the camera with most observations first.
        num_cameras: number of observed cameras.
    """
    words = WORDS
    if num_cameras > len(known):
        words += (
            f" {plural(len(known), 'camera')} of {num_cameras:,}, of those with most observations."
        )
    parts = [tag("h3", "Projection uncertainty"), tag("p", escape(words), class_="quiet")]
    parts += [_camera(index, one) for index, one in enumerate(known)]
    return "".join(parts)


def projection_data(known: Sequence[ProjectionUncertainty]) -> list[dict[str, Any]]:
    """Return the numbers of the figures."""
    return [
        {
            "camera_id": one.camera_id,
            "box": one.box.tolist(),
            "rows": one.count.shape[0],
            "columns": one.count.shape[1],
            "count": one.count.ravel().tolist(),
            "top": top_sigma(one),
            "distance": one.distance,
            "infinity": rounded(one.sigma()),
            "at_distance": rounded(one.sigma(one.distance)),
            "distances": rounded(one.distances),
            "curves": {name: rounded(values) for name, values in one.by_distance().items()},
        }
        for one in known
    ]


def _camera(index: int, one: ProjectionUncertainty) -> str:
    figures = [
        sigma_figure(one),
        sigma_figure(one, one.distance, "the median distance of its points"),
        distance_figure(one),
    ]
    name = escape(f"Camera {one.camera_id}, {one.model}")
    drawn = grid(figures, "h4", "planes")
    if index < 2:
        return tag("h4", name, class_="camera") + drawn
    return tag("details", tag("summary", name), drawn)
