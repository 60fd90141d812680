"""Residuals: how they are distributed, and what is systematic over each camera's image plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from bundle.base.words import plural
from bundle.figures.residual_field import SIGNIFICANT, ResidualField
from bundle.figures.residual_histogram import ResidualHistogram
from bundle.reports.page.heat import cells, directions, vectors
from bundle.reports.page.line_charts import error_bars, lines
from bundle.reports.page.page import tag
from bundle.reports.page.scale import linear, logarithmic
from bundle.reports.page.svg_charts import Curve, curves, place_x, place_y

__all__ = ["field_data", "field_section", "histogram_data", "histogram_section"]

FEW_IDS = 4


def histogram_section(histogram: ResidualHistogram) -> str:
    """Return both histograms."""
    x_scale = linear(histogram.edges.tolist(), low=None)
    drawn, highest = [], 1.0
    for index, (label, counts) in enumerate(histogram.coordinates.items()):
        drawn.append(_stairs(label, histogram.edges.tolist(), counts.tolist(), index))
        highest = max(highest, float(counts.max(initial=0)))
    y_scale = linear([0.0, 1.05 * highest])
    last = [*histogram.coordinates][-1]
    normal = _normal(histogram, last)
    points = "L".join(
        f"{place_x(x_scale(x)):.1f} {place_y(y_scale(y)):.1f}" for x, y in zip(*normal, strict=True)
    )
    gauss = tag("path", d=f"M{points}", class_="gauss")
    coordinates = curves(drawn, x_scale, y_scale, "residual in x or y [px]", "count")
    coordinates = coordinates.replace("</svg>", gauss + "</svg>", 1)
    outside = ", ".join(
        f"{share:.2%} {label}" for label, share in histogram.share_outside.items() if share
    )
    words = f"Dashed: the normal distribution of sigma {histogram.sigma[last]:.3g} px"
    words += ", from the median."
    words += f" Beyond the axis: {outside}." if outside else ""
    lengths = [
        _stairs(label, histogram.length_edges.tolist(), counts.tolist(), index)
        for index, (label, counts) in enumerate(histogram.lengths.items())
    ]
    largest = max((float(c.max(initial=0)) for c in histogram.lengths.values()), default=1.0)
    length = curves(
        lengths,
        logarithmic(histogram.length_edges.tolist()),
        linear([0.0, 1.05 * largest]),
        "length of the residual [px], log scale",
        "count",
    )
    return tag(
        "div",
        tag("figure", tag("h3", "Coordinates"), coordinates, tag("figcaption", escape(words))),
        tag("figure", tag("h3", "Lengths"), length),
        class_="grid",
    )


def histogram_data(histogram: ResidualHistogram) -> dict[str, Any]:
    """Return the numbers of the histograms."""
    return {
        "edges": histogram.edges.tolist(),
        "coordinates": {key: value.tolist() for key, value in histogram.coordinates.items()},
        "length_edges": histogram.length_edges.tolist(),
        "lengths": {key: value.tolist() for key, value in histogram.lengths.items()},
        "sigma": histogram.sigma,
    }


def field_section(fields: Sequence[ResidualField], num_cameras: int) -> str:
    """Return the figures of every field; the largest magnitude is the same for all."""
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
    """Return the numbers of every field, cells row by row."""
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
            "mean_x": _rounded(field.mean[..., 0]),
            "mean_y": _rounded(field.mean[..., 1]),
            "rms": _rounded(field.rms),
            "standard_error": _rounded(field.standard_error),
            "radius": _rounded(field.profile.radius),
            "ring_count": field.profile.count.tolist(),
            "radial": _rounded(field.profile.radial),
            "radial_error": _rounded(field.profile.radial_error),
            "tangential": _rounded(field.profile.tangential),
            "tangential_error": _rounded(field.profile.tangential_error),
        }
        for field in fields
    ]


def field_name(field: ResidualField) -> str:
    """Return the name of a field: its camera, or how many."""
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
    factor = field.vector_factor

    def title(row: int, column: int) -> str:
        count = int(field.count[row, column])
        if count == 0:
            return "no observation"
        x, y = field.mean[row, column]
        words = f"{plural(count, 'observation')}, mean {x:+.3f}, {y:+.3f} px"
        if known[row, column]:
            words += f", significance {significance[row, column]:.1f}"
        return words

    counts = np.where(field.count > 0, field.count, np.nan).astype(float)
    figures = [
        _figure("Mean residual", vectors(field, factor, title),
                f"lines {factor:g} times as long as residuals"),
        _figure("Directions", directions(field), f"{len(field.dots):,} residuals"),
        _figure("Significance of the mean",
                cells(field, significance, max(2 * SIGNIFICANT, _top(significance)),
                      "significance", "standard errors"), ""),
        _figure("Magnitude", cells(field, field.rms, _top(field.rms), "magnitude", "px RMSE"), ""),
        _figure("Count", cells(field, counts, _top(counts), "count", "observations"), ""),
        tag("figure", tag("h4", "Radial profile"), _profile(field)),
    ]  # fmt: skip
    heading = tag("h3", escape(field_name(field).capitalize()), class_="camera")
    content = tag("p", facts, class_="quiet") + tag("div", *figures, class_="planes")
    if index < 2:
        return heading + content
    summary = tag("summary", escape(f"{field_name(field)}: {facts}"))
    return tag("details", summary, content)


def _figure(name: str, drawing: str, words: str) -> str:
    caption = tag("figcaption", escape(words)) if words else ""
    return tag("figure", tag("h4", name), drawing, caption)


def _profile(field: ResidualField) -> str:
    profile = field.profile
    radius = profile.radius.tolist()
    drawn, errors = [], []
    for index, (name, mean, error) in enumerate(
        (
            ("outwards", profile.radial, profile.radial_error),
            ("across", profile.tangential, profile.tangential_error),
        )
    ):
        drawn.append(Curve(name, radius, mean.tolist(), index))
        errors.append(error.tolist())
    reach = [
        sign * (abs(value) + (error if math.isfinite(error) else 0.0))
        for line, spread in zip(drawn, errors, strict=True)
        for value, error in zip(line.y, spread, strict=True)
        if math.isfinite(value)
        for sign in (-1, 1)
    ]
    x_scale = linear([0.0, *radius])
    y_scale = linear(reach or [-1.0, 1.0], low=None)
    bars = "".join(
        error_bars(line, spread, x_scale, y_scale)
        for line, spread in zip(drawn, errors, strict=True)
    )
    return lines(
        drawn, x_scale, y_scale, "distance from the principal point [px]", "mean residual [px]",
        extra=bars,
    )  # fmt: skip


def _stairs(label: str, edges: list[float], counts: list[float], colour: int) -> Curve:
    return Curve(label, edges, [*counts, counts[-1]], colour)


def _normal(histogram: ResidualHistogram, label: str) -> tuple[list[float], list[float]]:
    """Return the normal distribution of the middle of a histogram, as counts per bin."""
    sigma = max(histogram.sigma[label], 1e-300)
    edges = histogram.edges
    inside = float(histogram.coordinates[label].sum())
    total = inside / max(1.0 - histogram.share_outside[label], 1e-12)
    x = np.linspace(edges[0], edges[-1], 121)
    y = (
        total
        * (edges[1] - edges[0])
        / (sigma * np.sqrt(2 * np.pi))
        * np.exp(-0.5 * (x / sigma) ** 2)
    )
    return x.tolist(), y.tolist()


def _top(values: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    """Return the value that is drawn full: the 98th percentile."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, 0.98)) if len(known) else 1.0


def _rounded(values: np.ndarray[Any, np.dtype[np.float64]]) -> list[float]:
    """Return numbers to six digits; nan, which the page writes as null, stays."""
    return [float(f"{value:.6g}") for value in values.ravel().tolist()]
