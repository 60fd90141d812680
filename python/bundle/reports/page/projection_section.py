"""Projection uncertainty: heat maps over each camera's image, and curves against the distance."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import number, plural
from bundle.figures.projection_uncertainty import ProjectionUncertainty, contour_levels
from bundle.reports.page.contours import contours
from bundle.reports.page.heat import cells
from bundle.reports.page.line_charts import lines
from bundle.reports.page.page import tag
from bundle.reports.page.scale import Scale, linear, logarithmic
from bundle.reports.page.svg_charts import Curve

__all__ = ["projection_data", "projection_section"]

WIDE = 20.0
"""Ratio of sigmas from which on they are drawn on a logarithmic axis."""

WORDS = (
    "How far a point that stands still before the camera appears from where it should: one "
    "standard deviation in the worst direction, from the noise of the measurements. A small turn "
    "or shift of the camera that makes up for it is not counted (mrcal's projection uncertainty). "
    "A lens of another kind than the model is wrong by more, and where nothing was observed the "
    "model extrapolates."
)


def projection_section(known: Sequence[ProjectionUncertainty], num_cameras: int) -> str:
    """Return the figures of each camera.

    Args:
        known: most observations first.
        num_cameras: observed ones.
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
            "top": _top(one),
            "distance": one.distance,
            "infinity": _rounded(one.sigma()),
            "at_distance": _rounded(one.sigma(one.distance)),
            "distances": _rounded(one.distances),
            "curves": {name: _rounded(values) for name, values in one.by_distance().items()},
        }
        for one in known
    ]


def _camera(index: int, one: ProjectionUncertainty) -> str:
    top = _top(one)
    figures = [
        _map(one, one.sigma(), top, "At infinity", "uncertainty at infinity"),
        _map(one, one.sigma(one.distance), top, f"At a distance of {number(one.distance)}",
             "uncertainty at the median distance", "the median distance of its points"),
        tag("figure", tag("h4", "Against the distance"), _against_distance(one)),
    ]  # fmt: skip
    name = f"Camera {one.camera_id}, {one.model}"
    figures_of = tag("div", *figures, class_="planes")
    if index < 2:
        return tag("h4", escape(name), class_="camera") + figures_of
    return tag("details", tag("summary", escape(name)), figures_of)


def _map(
    one: ProjectionUncertainty,
    sigma: NDArray[np.float64],
    top: float,
    name: str,
    label: str,
    words: str = "",
) -> str:
    known = sigma[np.isfinite(sigma)]
    facts = (
        f"{_pixels(known.min())} to {_pixels(known.max())} px, median {_pixels(np.median(known))}"
    )
    missing = sigma.size - len(known)
    facts += f"; {plural(missing, 'cell')} without a ray" if missing else ""
    facts += f"; {words}" if words else ""

    def title(row: int, column: int) -> str:
        count = plural(int(one.count[row, column]), "observation", grouped=True)
        return f"{_pixels(sigma[row, column])} px, {count}"

    overlay = contours(one, sigma, contour_levels(sigma))
    drawing = cells(one, sigma, top, label, "px", titles=title, overlay=overlay)
    caption = tag("figcaption", escape(facts))
    return tag("figure", tag("h4", escape(name)), drawing, caption)


def _against_distance(one: ProjectionUncertainty) -> str:
    x = one.distances.tolist()
    drawn = [
        Curve(name, x, values.tolist(), index)
        for index, (name, values) in enumerate(one.by_distance().items())
    ]
    every = [y for curve in drawn for y in curve.y if np.isfinite(y) and y > 0]
    is_wide = max(every) > WIDE * min(every)
    y_scale = logarithmic(every) if is_wide else linear([0.0, 1.05 * max(every)])
    ticks = tuple(tick for tick in logarithmic(x).ticks if x[0] <= tick <= x[-1])
    x_scale = Scale(x[0], x[-1], ticks, is_logarithmic=True)
    return lines(
        drawn, x_scale, y_scale, "distance from the camera, log scale",
        f"uncertainty [px]{', log scale' if is_wide else ''}",
        marks={"median": one.distance},
    )  # fmt: skip


def _top(one: ProjectionUncertainty) -> float:
    """Return the sigma that is drawn full in both maps: the 98th percentile of both."""
    both = np.stack([one.sigma(), one.sigma(one.distance)])
    return float(f"{np.quantile(both[np.isfinite(both)], 0.98):.6g}")


def _pixels(value: float) -> str:
    return f"{float(value):.3g}"


def _rounded(values: NDArray[np.float64]) -> list[float]:
    """Return numbers to six digits; nan, which the page writes as null, stays."""
    return [float(f"{value:.6g}") for value in values.ravel().tolist()]
