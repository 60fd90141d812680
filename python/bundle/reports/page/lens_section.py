"""Lenses: what distortion does along the radius, and the parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import number
from bundle.figures.lens_curves import LensCurve
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.reports.page.line_charts import Band, lines
from bundle.reports.page.page import tag
from bundle.reports.page.scale import linear
from bundle.reports.page.svg_charts import Curve
from bundle.reports.page.table import table

__all__ = ["lens_data", "lens_section", "parameter_table"]


NONE = 1e-6
"""Distortion in pixels that is rounding."""


def lens_section(
    curves: Sequence[LensCurve], before: Mapping[int, LensCurve], num_cameras: int
) -> str:
    """Return a figure for each curve.

    Args:
        curves: now.
        before: those of the input, by camera id; where one is the same, it is not drawn.
        num_cameras: observed, of which these have most observations.
    """
    words = (
        "How far distortion moves the image of a ray outwards, the mean around the axis; dashed "
        "verticals: the observation farthest out, beyond which the curve is a guess, and the "
        "farthest corner of the image."
    )
    if num_cameras > len(curves):
        words += f" The {len(curves)} cameras with most observations, of {num_cameras:,}."
    figures = [_figure(curve, before.get(curve.camera_id)) for curve in curves]
    return tag("p", words, class_="quiet") + tag("div", *figures, class_="grid")


def lens_data(curves: Sequence[LensCurve]) -> list[dict[str, Any]]:
    """Return the numbers of the curves."""
    return [
        {
            "camera_id": curve.camera_id,
            "model": curve.model,
            "radius": curve.radius.tolist(),
            "distortion": curve.distortion.tolist(),
            "sigma": curve.sigma.tolist(),
            "observed_radius": curve.observed_radius,
            "corner_radius": curve.corner_radius,
            "fold_radius": curve.fold_radius,
        }
        for curve in curves
    ]


def parameter_table(
    problem: Problem,
    initial: Problem | None,
    cameras: Sequence[int],
    sigmas: Mapping[int, NDArray[np.float64]] | None = None,
) -> str:
    """Return the parameters of some cameras, given by index, one a row.

    Args:
        problem: whose cameras they are.
        initial: the same before a solve; None for none.
        cameras: indices.
        sigmas: standard deviations by index, nan where held; None where unknown.
    """
    head = ["camera", "model", "parameter", *(["before"] if initial else []), "value"]
    head += ["sigma"] if sigmas is not None else []
    rows = []
    for camera in cameras:
        model = problem.camera_models[camera]
        for index, name in enumerate(camera_models()[model]):
            row = [f"{problem.camera_ids[camera]}", model, name]
            if initial is not None:
                same = initial.camera_models[camera] == model
                row.append(f"{initial.camera_params[camera, index]:.7g}" if same else "-")
            row.append(f"{problem.camera_params[camera, index]:.7g}")
            if sigmas is not None:
                value = float(sigmas[camera][index]) if camera in sigmas else math.nan
                row.append(number(value) if math.isfinite(value) else "held")
            rows.append(row)
    return table(head, rows, words=(1, 2), rows_shown=16)


def _figure(curve: LensCurve, before: LensCurve | None) -> str:
    drawn = [Curve("now", curve.radius.tolist(), curve.distortion.tolist(), 0)]
    moved = before is not None and not (
        len(before.radius) == len(curve.radius)
        and np.allclose(before.radius, curve.radius)
        and np.allclose(before.distortion, curve.distortion)
    )
    if before is not None and moved:
        drawn = [
            Curve("before", before.radius.tolist(), before.distortion.tolist(), 6, 1),
            Curve("after", curve.radius.tolist(), curve.distortion.tolist(), 0),
        ]
    bands = []
    if len(curve.sigma):
        low, high = curve.distortion - curve.sigma, curve.distortion + curve.sigma
        bands.append(Band(curve.radius.tolist(), low.tolist(), high.tolist()))
    marks = {
        name: value
        for name, value in (("observed", curve.observed_radius), ("corner", curve.corner_radius))
        if math.isfinite(value)
    }
    heights = [y for line in drawn for y in line.y if math.isfinite(y)]
    heights += [y for band in bands for y in (*band.low, *band.high) if math.isfinite(y)]
    if all(abs(height) < NONE for height in heights):
        heights = []
    x_scale = linear([0.0, *(x for line in drawn for x in line.x), *marks.values()])
    y_scale = linear([*heights, 0.0] if heights else [-1.0, 1.0], low=None)
    chart = lines(
        drawn, x_scale, y_scale, "distance from the principal point [px]", "distortion [px]",
        bands=bands, marks=marks,
    )  # fmt: skip
    words = []
    if bands:
        words.append("Shaded: one standard deviation.")
    if math.isfinite(curve.fold_radius):
        words.append(
            f"The lens folds at {curve.fold_radius:.0f} px: nothing is imaged farther out."
        )
    title = tag("h4", escape(f"Camera {curve.camera_id}, {curve.model}"))
    caption = tag("figcaption", escape(" ".join(words))) if words else ""
    return tag("figure", title, chart, caption)
