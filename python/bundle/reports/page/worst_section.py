"""Images with the largest residuals, drawn on their photographs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape

from bundle.base.words import pixels
from bundle.errors import shown
from bundle.figures.image_residuals import ImageResiduals
from bundle.figures.residual_figures import image_figure, image_name
from bundle.reports.page.page import tag
from bundle.reports.page.pictures import Photograph, photograph
from bundle.reports.page.svg import grid
from bundle.reports.page.table import table

__all__ = ["worst_section"]

SHAPE = 0.02
"""Relative difference up to which two aspect ratios count as equal."""


def worst_section(
    images: Sequence[ImageResiduals], folder: str | os.PathLike[str] | None
) -> tuple[str, list[str]]:
    """Return the section, and one sentence per missing part."""
    head = ["image", "camera", "observations", "RMSE [px]", "largest [px]"]
    rows = [
        [image_name(image), str(image.camera_id), f"{image.error.num_observations:,}",
         pixels(image.error.rmse), pixels(image.error.max)]
        for image in images
    ]  # fmt: skip
    figures, missing, misfits = [], [], []
    for image in images:
        picture = None if folder is None else photograph(folder, image.error.name)
        if folder is not None and picture is None:
            missing.append(image_name(image))
        if picture is not None and not _fits(picture, image):
            misfits.append(f"{image_name(image)} ({picture.size[0]} x {picture.size[1]})")
            picture = None
        figures.append(image_figure(image, picture=picture and picture.address))
    notes = []
    if missing:
        notes.append(f"No photograph in {shown(str(folder))} for {_listed(missing)}.")
    if misfits:
        notes.append(f"Photographs in another shape than their cameras: {_listed(misfits)}.")
    words = "Lines go from the measurement to the projection, longer by the factor given."
    parts = [
        table(head, rows),
        tag("p", words, class_="quiet"),
        *(tag("p", escape(note), class_="warn") for note in notes),
        grid(figures, class_="planes"),
    ]
    return "".join(parts), notes


def _fits(picture: Photograph, image: ImageResiduals) -> bool:
    """Tell whether a photograph has the aspect ratio of its camera's images."""
    if min(image.size) <= 0:
        return False
    ratio = picture.size[0] / picture.size[1] * image.size[1] / image.size[0]
    return abs(ratio - 1.0) < SHAPE


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
