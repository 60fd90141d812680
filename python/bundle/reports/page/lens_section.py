"""Lens section: distortion along the radius, and the parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from bundle.base.words import number
from bundle.figures.drawing import Figure
from bundle.figures.lens_curves import LensCurve
from bundle.figures.lens_figures import lens_figure
from bundle.model.cameras import camera_models
from bundle.model.problem import Problem
from bundle.reports.page.page import tag
from bundle.reports.page.svg import grid
from bundle.reports.page.table import table

__all__ = ["lens_section", "parameter_table"]


def lens_section(
    curves: Sequence[LensCurve], before: Mapping[int, LensCurve], num_cameras: int
) -> str:
    """Return one figure per curve.

    Args:
        curves: current curves.
        before: curves of the input by camera id; drawn only where they differ.
        num_cameras: number of observed cameras; the curves are of those with most observations.
    """
    words = (
        "Distortion moves the image of a ray outwards by this much (mean around the axis). Dashed "
        "verticals: the outermost observation, beyond which the curve extrapolates, and the "
        "farthest corner of the image."
    )
    if num_cameras > len(curves):
        words += f" The {len(curves)} cameras with most observations, of {num_cameras:,}."
    figures = [_figure(curve, before.get(curve.camera_id)) for curve in curves]
    return tag("p", words, class_="quiet") + grid(figures, "h4")


def parameter_table(
    problem: Problem,
    initial: Problem | None,
    cameras: Sequence[int],
    sigmas: Mapping[int, NDArray[np.float64]] | None = None,
) -> str:
    """Return the parameters of some cameras, one camera per row.

    Args:
        problem: problem with the cameras.
        initial: the problem before a solve; None without a solve.
        cameras: indices of the cameras.
        sigmas: standard deviations by index, NaN for constant parameters; None if unknown.
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


def _figure(curve: LensCurve, before: LensCurve | None) -> Figure:
    curves = {"now": curve}
    if before is not None and not (
        len(before.radius) == len(curve.radius)
        and np.allclose(before.radius, curve.radius)
        and np.allclose(before.distortion, curve.distortion)
    ):
        curves = {"before": before, "after": curve}
    words = ["Shaded: one standard deviation."] if len(curve.sigma) else []
    if math.isfinite(curve.fold_radius):
        words.append(
            f"The lens folds at {curve.fold_radius:.0f} px: nothing is imaged farther out."
        )
    return lens_figure(curves, f"Camera {curve.camera_id}, {curve.model}", " ".join(words))
