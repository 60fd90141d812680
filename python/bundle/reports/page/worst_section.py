"""The images of largest residuals, drawn on their photographs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape

import numpy as np

from bundle.base.words import pixels, plural
from bundle.errors import shown
from bundle.figures.image_residuals import ImageResiduals
from bundle.reports.page.page import tag
from bundle.reports.page.photographs import Photograph, photograph
from bundle.reports.page.table import table

__all__ = ["worst_section"]

WIDTH = 400.0
LONGEST = 0.08
SHAPE = 0.02


def worst_section(
    images: Sequence[ImageResiduals], folder: str | os.PathLike[str] | None
) -> tuple[str, list[str]]:
    """Return the section, and a sentence for each thing that is missing from it."""
    head = ["image", "camera", "observations", "RMSE [px]", "largest [px]"]
    rows = [
        [_name(image), str(image.camera_id), f"{image.error.num_observations:,}",
         pixels(image.error.rmse), pixels(image.error.max)]
        for image in images
    ]  # fmt: skip
    figures, missing, misfits = [], [], []
    for image in images:
        picture = None if folder is None else photograph(folder, image.error.name)
        if folder is not None and picture is None:
            missing.append(_name(image))
        if picture is not None and not _fits(picture, image):
            misfits.append(f"{_name(image)} ({picture.size[0]} x {picture.size[1]})")
            picture = None
        figures.append(_figure(image, picture))
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
        tag("div", *figures, class_="planes"),
    ]
    return "".join(parts), notes


def _figure(image: ImageResiduals, picture: Photograph | None) -> str:
    low, high = _frame(image)
    size = high - low
    width, height = WIDTH, WIDTH * float(size[1] / size[0])
    if height > WIDTH:
        width, height = WIDTH * width / height, WIDTH
    pixel = width / float(size[0])
    largest = float(np.hypot(*image.residual.T).max(initial=0.0))
    factor = _round_down(LONGEST * float(size.max()) / largest) if largest > 0 else 1.0
    lines = "".join(
        f"M{x:.1f} {y:.1f}l{dx:.1f} {dy:.1f}"
        for (x, y), (dx, dy) in zip(
            (image.xy - low) * pixel, image.residual * factor * pixel, strict=True
        )
    )
    frame = tag("rect", class_="plane", width=f"{width:.1f}", height=f"{height:.1f}")
    content = [tag("path", d=lines, class_="residuals")] if lines else []
    if picture is not None:
        content = [
            tag("image", href=picture.address, width=f"{width:.1f}", height=f"{height:.1f}",
                preserveAspectRatio="none"),
            tag("path", d=lines, class_="casing"),
            *content,
        ]  # fmt: skip
    drawing = tag(
        "svg", frame, *content, viewBox=f"0 0 {width:.1f} {height:.1f}", role="img",
        class_="photographed" if picture else "unphotographed",
        aria_label=f"residuals of {_name(image)}",
    )  # fmt: skip
    words = f"{_name(image)}: {plural(len(image.xy), 'residual')}"
    if len(image.xy) < image.error.num_observations:
        words = f"{_name(image)}: the largest {len(image.xy)} residuals"
    return tag("figure", drawing, tag("figcaption", escape(f"{words}, {factor:g} times as long")))


def _frame(image: ImageResiduals) -> tuple[np.ndarray, np.ndarray]:
    """Return opposite corners of the image; of the box of its observations where unknown."""
    if min(image.size) > 0:
        return np.zeros(2), np.array(image.size, float)
    if len(image.xy) == 0:
        return np.zeros(2), np.ones(2)
    low, high = image.xy.min(axis=0), image.xy.max(axis=0)
    margin = max(0.05 * float((high - low).max()), 1.0)
    return low - margin, high + margin


def _fits(picture: Photograph, image: ImageResiduals) -> bool:
    """Tell whether a photograph has the shape of its camera's images."""
    if min(image.size) <= 0:
        return False
    ratio = picture.size[0] / picture.size[1] * image.size[1] / image.size[0]
    return abs(ratio - 1.0) < SHAPE


def _round_down(value: float) -> float:
    if not np.isfinite(value) or value <= 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-12)))


def _name(image: ImageResiduals) -> str:
    return shown(image.error.name) or f"image {image.error.image_id}"


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more
