"""Projection uncertainty: heat maps over each camera's image, and curves over the distance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bundle.figures.lens_figures import distance_figure, sigma_figure, top_sigma
from bundle.figures.projection_uncertainty import ProjectionUncertainty
from bundle.reports.page.table import rounded
from bundle.reports.sections import Section

WORDS = (
    "Standard deviation of the pixel of a point that is fixed to the camera, in the worst "
    "direction, from the noise of the measurements (mrcal's projection uncertainty). Errors of the "
    "lens model come on top, and where nothing was observed the model extrapolates."
)


def projection_sections(known: Sequence[ProjectionUncertainty]) -> list[Section]:
    """Return the figures of each camera; those of the first show, the others are details."""
    sections = []
    for index, one in enumerate(known):
        figures = [
            sigma_figure(one),
            sigma_figure(one, one.distance, "the median distance of its points"),
            distance_figure(one),
        ]
        title = f"Projection uncertainty of camera {one.camera_id}, {one.model}"
        sections.append(
            Section(
                title=title,
                text=[] if index else [WORDS],
                figures=figures,
                is_joined=True,
                is_detail=index > 0,
            )
        )
    return sections


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
