"""Figures of lenses: distortion along the radius, and the certainty of projections."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from bundle.base.words import number, plural
from bundle.figures.axes import Axis, linear, logarithmic
from bundle.figures.drawing import Figure, over_image
from bundle.figures.lens_curves import LensCurve
from bundle.figures.marks import GREY, Array, Cells, Line, Places
from bundle.figures.projection_uncertainty import ProjectionUncertainty, contour_levels

__all__ = ["distance_figure", "lens_figure", "sigma_figure", "top_sigma"]

NONE = 1e-6
"""Limit in pixels below which distortion is a rounding error."""

WIDE = 20.0
"""Ratio of sigmas above which the axis is logarithmic."""


def lens_figure(curves: Mapping[str, LensCurve], title: str = "", note: str = "") -> Figure:
    """Return the figure of distortion against the distance from the principal point.

    Args:
        curves: curves by label. "before" is grey and dashed. The others have sigma bands, and
            marks at the farthest observation and at the farthest image corner.
        title: title of the figure.
        note: text below the figure.
    """
    lines, places = [], []
    now = [label for label in curves if label != "before"]
    for label, curve in curves.items():
        before = label == "before"
        colour = GREY if before else now.index(label)
        sigma = curve.sigma if len(curve.sigma) and not before else None
        lines.append(
            Line(label, curve.radius, curve.distortion, sigma, colour=colour, dash=int(before))
        )
        if not before:
            found = (("observed", curve.observed_radius), ("corner", curve.corner_radius))
            at = {name: value for name, value in found if math.isfinite(value)}
            places.append(Places(at, colour if len(now) > 1 else GREY))
    spread = [0.0 if line.sigma is None else line.sigma for line in lines]
    ends = [line.y + sign * s for line, s in zip(lines, spread, strict=True) for sign in (-1, 1)]
    heights = np.concatenate([np.zeros(0), *ends])
    heights = heights[np.isfinite(heights)]
    if (np.abs(heights) < NONE).all():
        heights = np.array([-1.0, 1.0])
    reach = [x for line in lines for x in line.x.tolist()]
    reach += [x for mark in places for x in mark.at.values()]
    return Figure(
        name="distortion",
        title=title,
        x=linear([0.0, *reach], "distance from the principal point [px]"),
        y=linear([*heights.tolist(), 0.0], "distortion [px]", low=None),
        marks=(*lines, *places),
        note=note,
    )


def sigma_figure(
    known: ProjectionUncertainty, distance: float = math.inf, words: str = ""
) -> Figure:
    """Return the figure of the uncertainty over the image, with contours.

    Args:
        known: uncertainty of a camera.
        distance: distance of the points [length unit].
        words: description of the distance, for the note.
    """
    sigma = known.sigma(distance)
    seen = sigma[np.isfinite(sigma)]
    note = ""
    if len(seen):
        note = f"{_pixels(seen.min())} to {_pixels(seen.max())} px, median "
        note += f"{_pixels(np.median(seen))}"
    missing = sigma.size - len(seen)
    note += f"; {plural(missing, 'cell')} without a ray" if missing else ""
    note += f"; {words}" if words else ""
    titles = tuple(
        f"{_pixels(value)} px, {plural(int(count), 'observation', grouped=True)}"
        for value, count in zip(sigma.ravel(), known.count.ravel(), strict=True)
    )
    levels = contour_levels(sigma) if min(sigma.shape) > 1 else []
    cells = Cells(sigma, top_sigma(known), "px", titles, tuple(levels))
    far = math.isinf(distance)
    title = "At infinity" if far else f"At a distance of {number(distance)}"
    name = "uncertainty at infinity" if far else "uncertainty at the median distance"
    return over_image(known.box, name, title, cells, note=note)


def distance_figure(known: ProjectionUncertainty) -> Figure:
    """Return the uncertainty against the distance, with a mark at the median distance."""
    x = known.distances
    curves = known.by_distance()
    heights = [y for values in curves.values() for y in values.tolist() if 0 < y < math.inf]
    is_wide = max(heights, default=1.0) > WIDE * min(heights, default=1.0)
    label = f"uncertainty [px]{', log scale' if is_wide else ''}"
    y_axis = (
        logarithmic(heights, label)
        if is_wide
        else linear([0.0, 1.05 * max(heights, default=1.0)], label)
    )
    ticks = tuple(tick for tick in logarithmic(x.tolist()).ticks if x[0] <= tick <= x[-1])
    across = "distance from the camera, log scale"
    return Figure(
        name="uncertainty_against_distance",
        title="Against the distance",
        x=Axis(float(x[0]), float(x[-1]), ticks, is_logarithmic=True, label=across),
        y=y_axis,
        marks=(
            *(Line(name, x, y, colour=k) for k, (name, y) in enumerate(curves.items())),
            Places({"median": known.distance}),
        ),
    )


def top_sigma(known: ProjectionUncertainty) -> float:
    """Return the top of the colour scale: the 98th percentile of sigma at two distances."""
    both: Array = np.stack([known.sigma(), known.sigma(known.distance)])
    return float(f"{np.quantile(both[np.isfinite(both)], 0.98):.6g}")


def _pixels(value: float) -> str:
    return f"{float(value):.3g}"
