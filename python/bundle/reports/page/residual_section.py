"""Systematic patterns of residuals over each camera's image plane."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bundle.base.words import plural
from bundle.figures.residual_field import SIGNIFICANT, ResidualField, RowResiduals, row_figure
from bundle.figures.residual_figures import field_figures
from bundle.reports.page.table import rounded
from bundle.reports.sections import Section

FEW_IDS = 4


def field_sections(
    fields: Sequence[ResidualField], num_cameras: int, rows: Mapping[str, RowResiduals]
) -> list[Section]:
    """Return the figures of all fields; those of the first show, the others are details.

    Args:
        fields: residual fields, at least one.
        num_cameras: number of cameras with observations.
        rows: residuals by row, by label; empty: unknown.
    """
    words = (
        "Residuals are projection minus measurement. A lens model that fits leaves no pattern. "
        f"Bold lines: the mean of a cell exceeds {SIGNIFICANT:g} standard errors, as 1 % of the "
        "cells do by chance."
    )
    shown = {key for field in fields for key in field.camera_ids if len(field.camera_ids) == 1}
    if num_cameras > len(shown):
        words += f" Of {plural(num_cameras, 'camera')}, those with most observations are shown"
        pooled = any(len(field.camera_ids) > 1 for field in fields)
        words += ", after those of the commonest model and image size together." if pooled else "."
    first, rest = fields[0], fields[1:]
    mean, direction, significance, magnitude, count, profile = field_figures(first)
    return [
        Section(
            title="Residuals over the image", text=[words, _facts(first)],
            figures=[mean, significance, profile, *([row_figure(rows)] if rows else [])],
        ),
        Section(
            title="Directions, magnitude and count", figures=[direction, magnitude, count],
            is_detail=True,
        ),
        *(
            Section(title=_facts(field), figures=field_figures(field), is_detail=True)
            for field in rest
        ),
    ]  # fmt: skip


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


def _facts(field: ResidualField) -> str:
    many, cells = field.num_significant
    name = f"Camera {field.camera_ids[0]}"
    if len(field.camera_ids) > 1:
        name = f"{len(field.camera_ids):,} cameras together"
    facts = (
        f"{name}: {plural(field.num_images, 'image', grouped=True)}, "
        f"{plural(field.num_observations, 'observation', grouped=True)}, cells of "
        f"{field.cell_size[0]:.0f} x {field.cell_size[1]:.0f} px"
    )
    if cells:
        facts += f"; {many} of {cells} cells with a significant mean"
    if field.num_outside:
        facts += f"; {plural(field.num_outside, 'observation')} outside the grid left out"
    return facts + "."
