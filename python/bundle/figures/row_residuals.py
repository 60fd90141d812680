"""Residuals by row: what the images of a moving camera with a rolling shutter have in common.

An image that moves by (a, b) pixels during its readout has residuals of about (a, b) s at the row s
from the middle, as a share of the height. Its pose absorbs shift and rotation, its focal length a
part; what remains grows towards the first and the last row: shear in x, anisotropy in y. Signs and
sizes differ from image to image, so that means over all images vanish. The profile therefore has
the size of the mean residual of an image in a band of rows, over the images i with n_i >= 3
observations there:

    size = sqrt(mean of m_i^2),    noise: sqrt(mean of sigma^2 / n_i),

with m_i the mean of a coordinate, and sigma from the median length, which is 1.1774 sigma.
Residuals beyond 5 sigma are left out. Without motion, size and noise agree in all bands.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from bundle.base.records import dataclass
from bundle.figures.axes import linear
from bundle.figures.drawing import Figure
from bundle.figures.marks import GREY, Line
from bundle.model.problem import Problem
from bundle.model.residuals import Residuals

NUM_BANDS = 12
FEWEST = 3
FEWEST_IMAGES = 3
_RAYLEIGH_MEDIAN = 1.17741
_OUTLIER = 5.0


@dataclass(frozen=True, eq=False, kw_only=True)
class RowResiduals:
    """Sizes of the mean residuals of images in bands of rows.

    Attributes:
        is_by_column: True for bands of columns, if most cameras are read column by column.
        row: (bands,) middle of each band, as a share of the height, 0 at the top.
        num_images: (bands,) images with enough observations.
        size: (bands, 2) rms over the images of the mean residual in x and y [pixels]; NaN with
            fewer than 3 images.
        noise: (bands,) expectation of both without motion [pixels].
    """

    is_by_column: bool
    row: NDArray[np.float64]
    num_images: NDArray[np.int64]
    size: NDArray[np.float64]
    noise: NDArray[np.float64]


def row_residuals(problem: Problem, found: Residuals) -> RowResiduals | None:
    """Return the residuals of a problem by row; None if sizes of images are unknown."""
    camera = problem.image_camera[problem.observation_image]
    size = problem.camera_sizes[camera]
    chosen = found.counted & (size > 0).all(axis=1)
    if not chosen.any():
        return None
    lengths = found.lengths[chosen]
    sigma = float(np.median(lengths)) / _RAYLEIGH_MEDIAN
    rows = np.flatnonzero(chosen)[lengths <= _OUTLIER * sigma]
    shutter = problem.rolling_shutter
    axis = np.zeros(len(camera), int) if shutter is None else shutter.axis[camera]
    by_column = bool((axis[rows] == 2).mean() > 0.5) if len(rows) else False
    coordinate = 0 if by_column else 1
    share = problem.observation_xy[rows, coordinate] / size[rows, coordinate]
    band = np.clip((share * NUM_BANDS).astype(np.int64), 0, NUM_BANDS - 1)
    cell = problem.observation_image[rows].astype(np.int64) * NUM_BANDS + band
    cells = problem.num_images * NUM_BANDS
    count = np.bincount(cell, minlength=cells).reshape(-1, NUM_BANDS)
    there = count >= FEWEST
    num_images = there.sum(axis=0)
    known = np.where(num_images >= FEWEST_IMAGES, num_images, np.nan)
    weight = there / np.maximum(count, 1)
    means = [
        np.bincount(cell, found.xy[rows, k], cells).reshape(-1, NUM_BANDS) * weight for k in (0, 1)
    ]
    return RowResiduals(
        is_by_column=by_column,
        row=(np.arange(NUM_BANDS) + 0.5) / NUM_BANDS,
        num_images=num_images,
        size=np.stack([np.sqrt((mean**2).sum(axis=0) / known) for mean in means], axis=1),
        noise=sigma * np.sqrt(weight.sum(axis=0) / known),
    )


def rows_of_sets(sets: Mapping[str, tuple[Problem, Residuals]]) -> dict[str, RowResiduals]:
    """Return the residuals by row of labelled problems whose images have known sizes."""
    found = {label: row_residuals(*one) for label, one in sets.items()}
    return {label: one for label, one in found.items() if one is not None}


def row_figure(sets: Mapping[str, RowResiduals]) -> Figure:
    """Return the sizes by row of labelled sets; the last is solid, earlier ones are dashed."""
    last = [*sets][-1]
    marks = []
    for label, found in sets.items():
        words = "" if len(sets) == 1 else f" {label}"
        for k, name in enumerate(("x", "y")):
            dash = 0 if label == last else 1
            marks.append(Line(name + words, found.row, found.size[:, k], colour=k, dash=dash))
    now = sets[last]
    marks.append(Line("noise alone", now.row, now.noise, colour=GREY, dash=2))
    what = "column / width" if now.is_by_column else "row / height"
    name = "column" if now.is_by_column else "row"
    highest = [float(np.nanmax(mark.y, initial=0.0)) for mark in marks]
    return Figure(
        name="row_residuals",
        title=f"Residuals by {name}",
        x=linear([0.0, 1.0], what),
        y=linear([0.0, *(1.05 * value for value in highest)], "mean residual of an image [px]"),
        marks=tuple(marks),
        note="Shear (x) and anisotropy (y) of single images. A rolling shutter lifts the first "
        f"and the last {name}s above the noise.",
    )
