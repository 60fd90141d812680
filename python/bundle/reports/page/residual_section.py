"""Residuals: their distribution, and systematic patterns over each camera's image plane."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from bundle.base.words import plural
from bundle.figures.residual_field import SIGNIFICANT, ResidualField
from bundle.figures.residual_figures import coordinate_figure, field_figures, length_figure
from bundle.figures.residual_histogram import ResidualHistogram
from bundle.reports.page.page import tag
from bundle.reports.page.svg import grid
from bundle.reports.page.table import rounded

__all__ = ["field_data", "field_section", "histogram_section"]

FEW_IDS = 4


def histogram_section(histogram: ResidualHistogram) -> str:
    """Return the figures of both histograms."""
    return grid([coordinate_figure(histogram), length_figure(histogram)])


def field_section(fields: Sequence[ResidualField], num_cameras: int) -> str:
    """Return the figures of all fields; they share one scale of magnitudes."""
    words = (
        "Residuals are projection minus measurement. A lens model that fits leaves no pattern: "
        "short lines in all directions, dots of all colours mixed. The significance is the length "
        "of a cell's mean in standard errors; where nothing is systematic 1 % of the cells exceed "
        f"{SIGNIFICANT:g}, whose lines are bold."
    )
    parts = [tag("p", words, class_="quiet")]
    shown = {key for field in fields for key in field.camera_ids if len(field.camera_ids) == 1}
    if num_cameras > len(shown):
        rest = f"Of {plural(num_cameras, 'camera')}, those with most observations are shown"
        pooled = any(len(field.camera_ids) > 1 for field in fields)
        rest += ", after those of the commonest model and image size together." if pooled else "."
        parts.append(tag("p", rest, class_="quiet"))
    return "".join(parts) + "".join(_field(index, field) for index, field in enumerate(fields))


def field_data(fields: Sequence[ResidualField]) -> list[dict[str, Any]]:
    """Return the numbers of all fields, cells row by row."""
    return [
        {
            "camera_ids": list(field.camera_ids) if len(field.camera_ids) <= FEW_IDS else None,
            "num_cameras": len(field.camera_ids),
            "box": field.box.tolist(),
            "center": field.center.tolist(),
            "rows": field.count.shape[0],
            "columns": field.count.shape[1],
            "vector_factor": field.vector_factor,
            "count": field.count.ravel().tolist(),
            "mean_x": rounded(field.mean[..., 0]),
            "mean_y": rounded(field.mean[..., 1]),
            "rms": rounded(field.rms),
            "standard_error": rounded(field.standard_error),
            "radius": rounded(field.profile.radius),
            "ring_count": field.profile.count.tolist(),
            "radial": rounded(field.profile.radial),
            "radial_error": rounded(field.profile.radial_error),
            "tangential": rounded(field.profile.tangential),
            "tangential_error": rounded(field.profile.tangential_error),
        }
        for field in fields
    ]


def field_name(field: ResidualField) -> str:
    """Return the name of a field: its camera, or the number of cameras."""
    if len(field.camera_ids) == 1:
        return f"camera {field.camera_ids[0]}"
    return f"{len(field.camera_ids):,} cameras together"


def _field(index: int, field: ResidualField) -> str:
    significance = field.significance
    known = np.isfinite(significance)
    many = int((significance[known] > SIGNIFICANT).sum())
    facts = (
        f"{plural(field.num_images, 'image', grouped=True)}, "
        f"{plural(field.num_observations, 'observation', grouped=True)}, cells of "
        f"{field.cell_size[0]:.0f} x {field.cell_size[1]:.0f} px"
    )
    if known.any():
        facts += f"; {many} of {int(known.sum())} cells with a significant mean"
    if field.num_outside:
        facts += f"; {plural(field.num_outside, 'observation')} outside the grid left out"
    heading = tag("h3", escape(field_name(field).capitalize()), class_="camera")
    content = tag("p", facts, class_="quiet") + grid(field_figures(field), "h4", "planes")
    if index < 2:
        return heading + content
    summary = tag("summary", escape(f"{field_name(field)}: {facts}"))
    return tag("details", summary, content)
